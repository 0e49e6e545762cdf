//! The target of `acquire`: a service of a robot, or the places of its subscribers.
//!
//! A service that limits its subscribers has places for them under an id of their own, such as `Turtlebot4/camera:subscribe`.
//! They are acquired, waited for and ended like the service itself.

use super::robot::{self, Robot};
use super::service::Service;
use super::store;
use crate::arguments::shown;
use ledger::Context;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{read_from, readers};
use std::sync::Arc;

/// A service with the robot that offers it.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    pub(crate) robot: Arc<Robot>,
    pub(crate) service: Service,
    /// `<robot><topic>`, or the id of the places of its subscribers.
    pub(crate) id: String,
}

impl Target {
    /// One of the robot's services.
    pub(crate) fn of(robot: &Robot, service: &Service) -> Self {
        Self { id: robot.service_id(service), robot: Arc::new(robot.clone()), service: service.clone() }
    }

    /// The places of the subscribers of one of the robot's services, if it limits them.
    pub(crate) fn of_readers(robot: &Robot, service: &Service) -> Option<Self> {
        let id = readers(&robot.service_id(service));
        Some(Self { service: service.for_readers()?, id, robot: Arc::new(robot.clone()) })
    }

    /// All of a robot that can be acquired: its services, each with the places of its subscribers.
    pub(crate) fn all_of(robot: &Robot) -> impl Iterator<Item = Self> + '_ {
        let both = |service| std::iter::once(Self::of(robot, service)).chain(Self::of_readers(robot, service));
        robot.services.iter().flat_map(both)
    }

    /// Are these the places of subscribers?
    pub(crate) fn is_for_readers(&self) -> bool {
        read_from(&self.id).is_some()
    }

    /// The id of the service itself, also of the places of its subscribers.
    pub(crate) fn service_id(&self) -> &str {
        read_from(&self.id).unwrap_or(&self.id)
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

    /// The service on a topic; without a topic the only one. Nobody publishes from the places of subscribers.
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

/// The service of an id such as `Turtlebot4/cmd_vel`, or of just `Turtlebot4` if that robot has exactly one; or the places of
/// its subscribers, `Turtlebot4/cmd_vel:subscribe`.
///
/// # Errors
/// [`Code::UnknownRobot`] or [`Code::UnknownService`], with the nearest name or the names that exist.
pub(crate) fn resolve(ctx: &Context<'_>, id: &str) -> Result<Target, Rejection> {
    let (name, topic) = split(id);
    let robot = robot::find(ctx, name)?;
    if let Some(topic) = read_from(topic)
        && let Some(service) = robot.services.iter().find(|service| service.topic == topic)
    {
        return Target::of_readers(&robot, service).ok_or_else(|| unlimited(&robot.service_id(service)));
    }
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

/// The refusal of places that nobody needs.
fn unlimited(service: &str) -> Rejection {
    Rejection::new(Code::UnknownService, format!("{service} does not limit its subscribers"))
        .found("no setting subscribers")
        .wanted("a service with mode=limited and subscribers=K")
        .next(format!("subscribe without a slot: ledgerctl echo {service}"))
}
