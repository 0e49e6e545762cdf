//! Services: the right to publish or subscribe on one topic of a robot.

use crate::arguments::shown;
use crate::grant;
use crate::nearest::did_you_mean;
use crate::robot::{self, Robot};
use crate::store;
use ledger::Context;
use ledger_contract::{Direction, Grant, Mode, ServiceSpec, ServiceState};
use ledger_rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Longest topic or type name, in bytes: what DDS allows.
const NAME_BYTES_MAX: usize = 255;
/// Age (milliseconds) beyond which a robot drops a message, unless the service says otherwise.
const AGE_MS_DEFAULT: u64 = 1_000;
/// Longest age (milliseconds) that a service may ask for.
const AGE_MS_MAX: u64 = 3_600_000;
/// Lease (milliseconds) of a grant, unless the service says otherwise.
const LEASE_MS_DEFAULT: u64 = 10_000;
/// Longest lease (milliseconds) that may be asked for, unless the service says otherwise.
const LEASE_MS_MAX_DEFAULT: u64 = 600_000;
/// Shortest lease (milliseconds): below it a grant would expire before its first use.
pub(crate) const LEASE_MS_MIN: u64 = 100;
/// Longest lease (milliseconds) of any service.
const LEASE_MS_MAX: u64 = 86_400_000;
/// Longest stop message, in bytes.
const STOP_BYTES_MAX: usize = 64 * 1024;

const _: () = assert!(LEASE_MS_MIN < LEASE_MS_DEFAULT && LEASE_MS_DEFAULT < LEASE_MS_MAX_DEFAULT);
const _: () = assert!(LEASE_MS_MAX_DEFAULT < LEASE_MS_MAX && AGE_MS_DEFAULT < AGE_MS_MAX);

/// The name of a direction, as in JSON and policies.
pub(crate) fn direction_name(direction: Direction) -> &'static str {
    match direction {
        Direction::Command => "command",
        Direction::Feed => "feed",
    }
}

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
}

impl Service {
    /// Checks everything that an owner describes and fills in the defaults.
    pub(crate) fn check(spec: ServiceSpec) -> Result<Self, Rejection> {
        check_topic(&spec.topic)?;
        check_type(&spec.type_name)?;
        let topic = &spec.topic;
        let within = |field: &str, value: u64, min: u64, max: u64| {
            if (min..=max).contains(&value) {
                return Ok(value);
            }
            Err(Rejection::new(Code::BadArgument, format!("{field} of service {topic} is out of range"))
                .found(format!("{value} ms"))
                .wanted(format!("{min} to {max} ms"))
                .next("give a value within this range"))
        };
        let max_age_ms = within("max_age_ms", spec.max_age_ms.unwrap_or(AGE_MS_DEFAULT), 1, AGE_MS_MAX)?;
        let lease_ms = spec.lease_ms.or(spec.lease_ms_max.map(|max| max.min(LEASE_MS_DEFAULT)));
        let lease_ms = within("lease_ms", lease_ms.unwrap_or(LEASE_MS_DEFAULT), LEASE_MS_MIN, LEASE_MS_MAX)?;
        let longest = spec.lease_ms_max.unwrap_or(LEASE_MS_MAX_DEFAULT.max(lease_ms));
        let lease_ms_max = within("lease_ms_max", longest, lease_ms, LEASE_MS_MAX).map_err(|refused| {
            refused.next(format!("lease_ms is {lease_ms} ms, and lease_ms_max is never shorter: set both"))
        })?;
        if let Some(stop) = &spec.stop_hex {
            let length = hex::decode(stop).map(|bytes| bytes.len()).unwrap_or_default();
            if !(4..=STOP_BYTES_MAX).contains(&length) {
                return Err(Rejection::new(Code::BadArgument, format!("stop_hex of service {topic} is no message"))
                    .found(shown(stop))
                    .wanted(format!("4 to {STOP_BYTES_MAX} bytes of CDR in hexadecimal digits")));
            }
        }
        let mode = spec.mode.unwrap_or(match spec.direction {
            Direction::Command => Mode::Exclusive,
            Direction::Feed => Mode::Open,
        });
        Ok(Self {
            topic: spec.topic,
            type_name: spec.type_name,
            mode,
            direction: spec.direction,
            max_age_ms,
            lease_ms,
            lease_ms_max,
            stop_hex: spec.stop_hex,
        })
    }
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

    /// The service with who holds it now.
    pub(crate) fn state(&self, ctx: &Context<'_>) -> Result<ServiceState, Rejection> {
        let grants: Vec<Grant> = grant::live(ctx, &self.id)?.into_iter().map(|holding| holding.grant).collect();
        let service = self.service.clone();
        Ok(ServiceState {
            service: self.id.clone(),
            robot: self.robot.name.clone(),
            organisation: self.robot.organisation.clone(),
            topic: service.topic,
            type_name: service.type_name,
            mode: service.mode,
            direction: service.direction,
            max_age_ms: service.max_age_ms,
            lease_ms: service.lease_ms,
            lease_ms_max: service.lease_ms_max,
            stop_hex: service.stop_hex,
            holder: grants.first().map(|grant| grant.holder.clone()).unwrap_or_default(),
            epoch: grant::newest_epoch(ctx, &self.id)?,
            expires: grants.first().map_or(0, |grant| grant.expires),
            holders: grants.into_iter().map(|grant| grant.holder).collect(),
        })
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

fn check_topic(topic: &str) -> Result<(), Rejection> {
    let valid =
        topic.len() <= NAME_BYTES_MAX && topic.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_ros_name));
    if valid {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "topic is not a ROS 2 name")
        .found(shown(topic))
        .wanted("a leading slash and names of letters, digits and \"_\" between slashes, e.g. /cmd_vel"))
}

fn check_type(type_name: &str) -> Result<(), Rejection> {
    let parts: Vec<&str> = type_name.split('/').collect();
    if type_name.len() <= NAME_BYTES_MAX
        && matches!(parts.as_slice(), [package, "msg", name] if is_ros_name(package) && is_ros_name(name))
    {
        return Ok(());
    }
    let next = match parts.as_slice() {
        [package, name] if is_ros_name(package) && is_ros_name(name) => format!("did you mean {package}/msg/{name}?"),
        _ => String::new(),
    };
    Err(Rejection::new(Code::BadName, "type is not a ROS 2 message type")
        .found(shown(type_name))
        .wanted("PACKAGE/msg/NAME, e.g. geometry_msgs/msg/Twist")
        .next(next))
}

fn is_ros_name(name: &str) -> bool {
    name.bytes().next().is_some_and(|first| first.is_ascii_alphabetic() || first == b'_')
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}
