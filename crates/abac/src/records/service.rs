//! Services: the right to publish or subscribe on one topic of a robot.

use super::robot::{self, Robot};
use super::store;
use crate::arguments::shown;
use ledger::Context;
use ledger_contract::{Direction, Mode, Sharing};
use ledger_rejection::{Code, Rejection};
use nearest::did_you_mean;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A registered service: a [`ServiceSpec`] with every default filled in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Service {
    pub(crate) topic: String,
    #[serde(rename = "type")]
    pub(crate) type_name: String,
    pub(crate) mode: Mode,
    pub(crate) direction: Direction,
    pub(crate) max_age_ms: u64,
    pub(crate) lease_ms: u64,
    pub(crate) lease_ms_max: u64,
    pub(crate) stop_hex: Option<String>,
    /// The settings of its rule; since rules 3.
    #[serde(default, skip_serializing_if = "Sharing::is_default")]
    pub(crate) sharing: Sharing,
}

/// A service with the robot that offers it.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    pub(crate) robot: Arc<Robot>,
    pub(crate) service: Service,
    /// `<robot><topic>`.
    pub(crate) id: String,
}

impl Target {
    /// One of the robot's services.
    pub(crate) fn of(robot: &Robot, service: &Service) -> Self {
        Self { id: robot.service_id(service), robot: Arc::new(robot.clone()), service: service.clone() }
    }
}

/// All services of a robot.
pub(crate) struct Offered(Vec<Arc<Target>>);

impl Offered {
    /// Reads the record of a robot.
    pub(crate) fn parse(key: &[u8], value: &[u8]) -> Result<Self, Rejection> {
        let robot: Arc<Robot> = Arc::new(store::parse(key, value)?);
        let target = |service: &Service| {
            Arc::new(Target { id: robot.service_id(service), robot: Arc::clone(&robot), service: service.clone() })
        };
        Ok(Self(robot.services.iter().map(target).collect()))
    }

    /// The service on a topic; without a topic the only one.
    pub(crate) fn find(&self, topic: &str) -> Option<&Arc<Target>> {
        match (topic, self.0.as_slice()) {
            ("", [only]) => Some(only),
            (topic, services) => services.iter().find(|target| target.service.topic == topic),
        }
    }
}

/// Robot and topic of a service's id; an empty topic if it names a robot only.
pub(crate) fn split(id: &str) -> (&str, &str) {
    id.find('/').map_or((id, ""), |slash| id.split_at(slash))
}

/// The service of an id such as `Turtlebot4/cmd_vel`, or of just `Turtlebot4` if that robot has exactly one.
///
/// # Errors
/// [`Code::UnknownRobot`] or [`Code::UnknownService`], with the nearest name or the names that exist.
pub(crate) fn resolve(ctx: &Context<'_>, id: &str) -> Result<Target, Rejection> {
    let (name, topic) = split(id);
    let robot = robot::find(ctx, name)?;
    let found = match (topic, robot.services.as_slice()) {
        ("", [only]) => Some(only),
        (topic, services) => services.iter().find(|service| service.topic == topic),
    };
    if let Some(service) = found {
        return Ok(Target::of(&robot, service));
    }
    let ids: Vec<String> = robot.services.iter().map(|service| robot.service_id(service)).collect();
    let (message, wanted) = if topic.is_empty() {
        (format!("robot {name} has {} services", ids.len()), format!("one of {}", ids.join(", ")))
    } else {
        (format!("robot {name} offers no service {}", shown(topic)), format!("one of {}", ids.join(", ")))
    };
    let next = did_you_mean(id, ids.iter().map(String::as_str), format!("ledgerctl robot show {name}"));
    Err(Rejection::new(Code::UnknownService, message).found(shown(id)).wanted(wanted).next(next))
}
