//! The ledger's answers as the bridge reads them, and what a route makes of its service.

use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{ServiceState, is_called};
use ledger_gate::{ABAC, sample::Sample, service::Service};
use serde::Deserialize;

use crate::{
    config::{RouteConfig, stop_sample},
    gateway::{Gateway, ask},
    names::{TopicName, TypeName},
    stop::stop_message,
};

/// The rights of the caller now, as `abac authorize` answers.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Authorization {
    pub(crate) epoch: u64,
    pub(crate) next_seq: u64,
    /// The name of the code, e.g. `MISSING_ATTRIBUTE`.
    #[serde(default)]
    name: String,
    /// Why not, in words.
    #[serde(default)]
    pub(crate) reason: String,
}

impl Authorization {
    /// The code, if this version knows it.
    pub(crate) fn code(&self) -> Option<Code> {
        Code::ALL.iter().copied().find(|code| code.name() == self.name)
    }
}

/// The identity of the caller, as `abac GetSubmittingClientIdentity` answers.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Caller {
    pub(crate) id: String,
}

/// Asks the ledger for a service.
pub(crate) async fn ask_service(gateway: &dyn Gateway, height: u64, id: &str) -> Result<(Service, u64), Rejection> {
    let (state, height): (ServiceState, u64) = ask(gateway, height, ABAC, "service", &[id]).await?;
    Ok((Service::try_from(state)?, height))
}

/// The local topic of a route, after a check that its type is the service's.
///
/// # Errors
/// [`Code::WrongType`], [`Code::BadName`].
pub(crate) fn topic_for(service: &Service, route: &RouteConfig) -> Result<TopicName, Rejection> {
    check_type(&service.service, &route.message, &service.type_name)?;
    match &route.topic {
        Some(topic) => Ok(topic.clone()),
        None => Ok(TopicName::parse(&service.topic)?),
    }
}

/// The message that stops the robot: of the route, else the owner's, else the type's. None for feeds, and for calls.
///
/// # Errors
/// [`Code::BadArgument`] if the owner's is no sample.
pub(crate) fn stop_for(
    service: &Service,
    route: &RouteConfig,
    own: Option<&Sample>,
) -> Result<Option<Sample>, Rejection> {
    if !service.is_command() || is_called(&service.type_name) {
        return Ok(None);
    }
    if let Some(stop) = own {
        return Ok(Some(stop.clone()));
    }
    match &service.stop_hex {
        Some(hex) => Ok(Some(stop_sample(hex, route.sample_bytes_max)?)),
        None => Ok(stop_message(&route.message)),
    }
}

fn check_type(service: &str, found: &TypeName, wanted: &str) -> Result<(), Rejection> {
    if found.to_string() == wanted {
        return Ok(());
    }
    Err(Rejection::new(Code::WrongType, format!("the route of {service} has another type than the service"))
        .found(found.to_string())
        .wanted(wanted)
        .next(format!("type = {wanted:?}, or let the owner register the service with {found}")))
}
