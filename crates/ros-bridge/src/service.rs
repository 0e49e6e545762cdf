//! The ledger's answers and events as the bridge reads them: the parts of their JSON that it uses.

use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};
use serde::{Deserialize, de::DeserializeOwned};

use crate::{
    config::{RouteConfig, stop_sample},
    gateway::{ABAC, Gateway, ask},
    names::{TopicName, TypeName},
    sample::Sample,
    stop::stop_message,
};

/// Longest payload of an event that is read, in bytes.
const EVENT_BYTES_MAX: usize = 64 * 1024;

/// A service, as `abac service` describes it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Service {
    /// Its id, e.g. `Turtlebot4/cmd_vel`.
    pub service: String,
    /// The robot that offers it.
    pub robot: String,
    /// The organisation that owns the robot.
    pub organisation: String,
    /// The ROS 2 topic.
    pub topic: String,
    /// The ROS 2 type.
    #[serde(rename = "type")]
    pub type_name: String,
    /// `open`, or another: then publishing needs a grant.
    pub mode: String,
    /// `command` or `feed`.
    pub direction: String,
    /// Age (milliseconds) beyond which the robot drops a message.
    pub max_age_ms: u64,
    /// Lease (milliseconds) of a grant that asks for none.
    pub lease_ms: u64,
    /// The message that stops the robot, if the owner gave one.
    pub stop_hex: Option<String>,
    /// The newest epoch ever given.
    pub epoch: u64,
}

/// A grant, as `abac grants` and the events `granted` and `renewed` tell it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Grant {
    /// The service.
    pub service: String,
    /// The holder, e.g. `Org1/Salma`.
    pub holder: String,
    /// The fencing token.
    pub epoch: u64,
    /// By how much a use or a renewal extends it, in milliseconds.
    pub lease_ms: u64,
    /// The smallest sequence number that the ledger accepts.
    #[serde(default)]
    pub next_seq: u64,
}

/// Payload of the event `released`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Released {
    /// The service.
    pub service: String,
    /// The former holder.
    pub holder: String,
    /// The epoch that ended.
    pub epoch: u64,
    /// Why.
    pub reason: String,
}

/// A revoked certificate, as `msp revocations` and the event `revoked` tell it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Revoked {
    /// SHA-256 of the issuer's distinguished name.
    pub issuer: Hash,
    /// Serial number in hexadecimal.
    pub serial: String,
}

/// The rights of the caller now, as `abac authorize` answers.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Authorization {
    pub(crate) epoch: u64,
    pub(crate) next_seq: u64,
}

/// The identity of the caller, as `abac GetSubmittingClientIdentity` answers.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Caller {
    pub(crate) id: String,
}

impl Service {
    /// Asks the ledger.
    pub(crate) async fn ask(gateway: &dyn Gateway, height: u64, id: &str) -> Result<(Self, u64), Rejection> {
        ask(gateway, height, ABAC, "service", &[id]).await
    }

    /// Does publishing need a grant? A mode that this version does not know is treated as the strictest.
    pub fn needs_grant(&self) -> bool {
        self.mode != "open"
    }

    /// Do users publish and the robot listens?
    pub fn is_command(&self) -> bool {
        self.direction != "feed"
    }

    /// The local topic of a route, after a check that its type is the service's.
    ///
    /// # Errors
    /// [`Code::WrongType`], [`Code::BadName`].
    pub(crate) fn topic_for(&self, route: &RouteConfig) -> Result<TopicName, Rejection> {
        check_type(&self.service, &route.message, &self.type_name)?;
        match &route.topic {
            Some(topic) => Ok(topic.clone()),
            None => Ok(TopicName::parse(&self.topic)?),
        }
    }

    /// The message that stops the robot: of the route, else the owner's, else the type's. None for feeds.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if the owner's is no sample.
    pub(crate) fn stop_for(&self, route: &RouteConfig) -> Result<Option<Sample>, Rejection> {
        if !self.is_command() {
            return Ok(None);
        }
        if let Some(stop) = &route.stop {
            return Ok(Some(stop.clone()));
        }
        match &self.stop_hex {
            Some(hex) => Ok(Some(stop_sample(hex, route.sample_bytes_max)?)),
            None => Ok(stop_message(&route.message)),
        }
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

/// Reads the payload of an event; none if it is not what this version knows.
pub(crate) fn read<T: DeserializeOwned>(payload: &[u8]) -> Option<T> {
    if payload.len() > EVENT_BYTES_MAX { None } else { serde_json::from_slice(payload).ok() }
}
