//! The terms of a service for its route: the topic and the stop message.

use ledger_base::rejection::{Code, Rejection};
use ledger_contract::is_called;
use ledger_gate::{sample::Sample, service::Service};

use super::kind::RouteConfig;
use crate::graph::{
    messages::stop::{stop_message, stop_sample},
    names::{TopicName, TypeName},
};

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
