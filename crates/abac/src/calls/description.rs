//! Descriptions of robots: what an owner may say, and what holds where the owner says nothing.

use crate::arguments::{Arguments, shown};
use crate::calls::attributes;
use crate::lifecycle::lease_bounds::LEASE_MS_MIN;
use crate::policy::decider::Decider;
use crate::records::robot::{self, Robot, SERVICES_MAX};
use crate::records::service::Service;
use crate::records::store;
use crate::rules;
use crate::rules::terms;
use ledger::Context;
use ledger_base::hash::Hash;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Direction, RobotSpec, ServiceSpec, Sharing, is_called};
use ledger_identity::{ATTRIBUTE_FORM, read_attribute};
use std::collections::BTreeSet;

/// Longest required attribute with its value, in bytes.
const ATTRIBUTE_BYTES_MAX: usize = 256;

/// Most organisations that a robot trusts.
const TRUSTED_MAX: usize = 256;

/// Longest JSON of one robot in `setup`, in bytes.
const SPEC_BYTES_MAX: usize = 256 * 1024;

/// Longest topic or type name, in bytes: what DDS allows.
const TOPIC_BYTES_MAX: usize = 255;

/// Age (milliseconds) beyond which a robot drops a message, unless the service says otherwise.
const AGE_MS_DEFAULT: u64 = 1_000;

/// Longest age (milliseconds) that a service may ask for.
const AGE_MS_MAX: u64 = 3_600_000;

/// Lease (milliseconds) of a grant, unless the service says otherwise.
const LEASE_MS_DEFAULT: u64 = 10_000;

/// Longest lease (milliseconds) that may be asked for, unless the service says otherwise.
const LEASE_MS_MAX_DEFAULT: u64 = 600_000;

/// Longest lease (milliseconds) of any service.
const LEASE_MS_MAX: u64 = 86_400_000;

/// Longest stop message, in bytes.
const STOP_BYTES_MAX: usize = 64 * 1024;

const _: () = assert!(LEASE_MS_MIN < LEASE_MS_DEFAULT && LEASE_MS_DEFAULT < LEASE_MS_MAX_DEFAULT);

const _: () = assert!(LEASE_MS_MAX_DEFAULT < LEASE_MS_MAX && AGE_MS_DEFAULT < AGE_MS_MAX);

/// Reads a description from one argument.
pub(crate) fn read_spec(args: Arguments<'_>, index: usize) -> Result<RobotSpec, Rejection> {
    let text = args.document(index, "ROBOT_JSON", SPEC_BYTES_MAX)?;
    serde_json::from_str(text).map_err(|fault| {
        args.bad(index, "ROBOT_JSON", fault.to_string(), "JSON of a robot: name, attribute_required, services")
    })
}

/// Rejects a change of a robot that was made from another version of it than the one that is registered.
pub(crate) fn check_base(name: &str, before: Option<&Robot>, base: Option<&str>) -> Result<(), Rejection> {
    let registered = before.map(|robot| robot.version.to_string()).unwrap_or_default();
    let told = |version: &str| match version {
        "" => "no robot of this name".to_owned(),
        version => format!("version {version}"),
    };
    match base {
        Some(base) if base != registered => {
            Err(Rejection::new(Code::RobotChanged, format!("robot {name} has changed in the meantime"))
                .found(told(&registered))
                .wanted(format!("{}, from which this was made", told(base))))
        }
        _ => Ok(()),
    }
}

/// Rejects the name of a new robot that differs from that of another one only in the case of its letters. People mix them up, and the
/// identity of a robot has its exact name.
pub(crate) fn check_look(ctx: &Context<'_>, name: &str) -> Result<(), Rejection> {
    let keys = ctx.range(b"robot/", usize::MAX);
    let names = keys.iter().filter_map(|(key, _)| std::str::from_utf8(key).ok()?.strip_prefix("robot/"));
    match names.into_iter().find(|known| known.eq_ignore_ascii_case(name) && *known != name) {
        None => Ok(()),
        Some(known) => Err(Rejection::new(
            Code::AlreadyExists,
            format!("{name} differs from a robot's name only in upper and lower case"),
        )
        .found(format!("robot {known}"))
        .wanted("a name that is visibly different from those of other robots")
        .next(format!("choose another name, or use exactly {known}"))),
    }
}

/// Checks a description and fills in what it leaves out. Without another word a robot trusts whom it trusted before, and a new one
/// its owner alone.
pub(crate) fn describe(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    spec: RobotSpec,
    before: Option<&Robot>,
) -> Result<Robot, Rejection> {
    let services = check_services(decider, &spec.name, spec.services)?;
    let trusted = match (spec.trusted, before) {
        (Some(trusted), _) => check_trusted(ctx, trusted)?,
        (None, Some(robot)) => robot.trusted.clone(),
        (None, None) => vec![organisation.to_owned()],
    };
    let attributes = attributes::described(spec.attributes, attributes::OF_ROBOT_BYTES_MAX)?;
    Ok(Robot {
        name: spec.name,
        organisation: organisation.to_owned(),
        attribute_required: check_attribute(&spec.attribute_required)?,
        trusted,
        services,
        attributes,
        version: Hash::ZERO,
    })
}

/// Checks everything that an owner describes and fills in the defaults.
pub(crate) fn check_service(decider: &Decider, spec: ServiceSpec) -> Result<Service, Rejection> {
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
            .next("use a value within this range"))
    };
    let max_age_ms = within("max_age_ms", spec.max_age_ms.unwrap_or(AGE_MS_DEFAULT), 1, AGE_MS_MAX)?;
    let lease_ms = spec.lease_ms.or(spec.lease_ms_max.map(|max| max.min(LEASE_MS_DEFAULT)));
    let lease_ms = within("lease_ms", lease_ms.unwrap_or(LEASE_MS_DEFAULT), LEASE_MS_MIN, LEASE_MS_MAX)?;
    let longest = spec.lease_ms_max.unwrap_or(LEASE_MS_MAX_DEFAULT.max(lease_ms));
    let lease_ms_max = within("lease_ms_max", longest, lease_ms, LEASE_MS_MAX).map_err(|refused| {
        refused.next(format!("lease_ms is {lease_ms} ms, and lease_ms_max must not be shorter: set both"))
    })?;
    if let Some(stop) = &spec.stop_hex {
        let length = hex::decode(stop).map(|bytes| bytes.len()).unwrap_or_default();
        if !(4..=STOP_BYTES_MAX).contains(&length) {
            return Err(Rejection::new(Code::BadArgument, format!("stop_hex of service {topic} is not a message"))
                .found(shown(stop))
                .wanted(format!("4 to {STOP_BYTES_MAX} bytes of CDR in hexadecimal digits")));
        }
    }
    let mode = spec.mode.unwrap_or_else(|| rules::default_mode(spec.direction));
    terms::check(decider.rules.chosen(&mode)?, &spec.sharing, topic)?;
    check_confidential(&spec.sharing, &spec.type_name, topic)?;
    check_speeds(spec.direction, &spec.type_name, &spec.sharing, topic)?;
    let attributes = attributes::described(spec.attributes, attributes::OF_SERVICE_BYTES_MAX)?;
    Ok(Service {
        topic: spec.topic,
        type_name: spec.type_name,
        mode,
        direction: spec.direction,
        max_age_ms,
        lease_ms,
        lease_ms_max,
        stop_hex: spec.stop_hex,
        sharing: spec.sharing,
        attributes,
    })
}

/// A maximum that no gate could enforce would be worse than none.
fn check_speeds(direction: Direction, type_name: &str, sharing: &Sharing, topic: &str) -> Result<(), Rejection> {
    const LINEAR: [&str; 2] = ["ackermann_msgs/msg/AckermannDrive", "ackermann_msgs/msg/AckermannDriveStamped"];
    const BOTH: [&str; 2] = ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"];
    let is_command = direction == Direction::Command;
    let has_angular = is_command && BOTH.contains(&type_name);
    let has_linear = has_angular || (is_command && LINEAR.contains(&type_name));
    let Sharing { max_linear_mm_s, max_angular_mrad_s, .. } = sharing;
    let refused = |key: &str, wanted: &str| {
        Err(Rejection::new(Code::BadArgument, format!("service {topic} cannot have {key}"))
            .found(format!("{direction} of {type_name}"))
            .wanted(format!("commands of {wanted}"))
            .next(format!("omit {key}: the gate finds no such speed in these messages")))
    };
    if max_angular_mrad_s.is_some() && !has_angular {
        return refused("max_angular_mrad_s", &BOTH.join(" or "));
    }
    if max_linear_mm_s.is_some() && !has_linear {
        return refused("max_linear_mm_s", &[BOTH, LINEAR].concat().join(" or "));
    }
    Ok(())
}

/// Calls and their replies are two services that share keys in no way yet: neither is confidential.
fn check_confidential(sharing: &Sharing, type_name: &str, topic: &str) -> Result<(), Rejection> {
    if !sharing.is_confidential() || !is_called(type_name) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadArgument, format!("service {topic} cannot be confidential"))
        .found(format!("confidential=true for the calls of {type_name}"))
        .wanted("confidential=true for messages: a type PACKAGE/msg/NAME")
        .next("omit confidential: calls and actions are not encrypted"))
}

pub(crate) fn check_attribute(required: &str) -> Result<String, Rejection> {
    let (key, value) = required.split_once('=').unwrap_or((required, "true"));
    if let Err(fault) = read_attribute(required) {
        let advice = match fault.question("") {
            none if none.is_empty() => "name the attribute that users must have".to_owned(),
            question => format!("{question} A robot requires one attribute; a policy may demand more"),
        };
        return Err(Rejection::new(Code::BadArgument, "attribute_required is not an attribute")
            .found(shown(required))
            .wanted(ATTRIBUTE_FORM)
            .next(advice));
    }
    if required.len() > ATTRIBUTE_BYTES_MAX {
        return Err(Rejection::new(Code::BadArgument, "attribute_required is not usable")
            .found(shown(required))
            .wanted(format!("KEY or KEY=VALUE, at most {ATTRIBUTE_BYTES_MAX} bytes"))
            .next("name the attribute that users must have; ledgerctl identity list shows attributes"));
    }
    Ok(format!("{key}={value}"))
}

fn check_services(decider: &Decider, robot: &str, specs: Vec<ServiceSpec>) -> Result<Vec<Service>, Rejection> {
    if !(1..=SERVICES_MAX).contains(&specs.len()) {
        return Err(Rejection::new(
            Code::BadArgument,
            format!("the number of services of robot {robot} is out of range"),
        )
        .found(format!("{} services", specs.len()))
        .wanted(format!("1 to {SERVICES_MAX}")));
    }
    let services = specs.into_iter().map(|spec| check_service(decider, spec)).collect::<Result<Vec<_>, _>>()?;
    let mut topics = BTreeSet::new();
    for service in &services {
        if !topics.insert(&service.topic) {
            return Err(Rejection::new(Code::AlreadyExists, format!("robot {robot} offers {} twice", service.topic))
                .wanted("each topic once"));
        }
    }
    Ok(services)
}

pub(crate) fn check_trusted(ctx: &mut Context<'_>, trusted: Vec<String>) -> Result<Vec<String>, Rejection> {
    let members = organisations(ctx)?;
    if trusted.len() > TRUSTED_MAX {
        return Err(Rejection::new(Code::LimitExceeded, "too many trusted organisations")
            .found(trusted.len().to_string())
            .wanted(format!("at most {TRUSTED_MAX}")));
    }
    if let Some(stranger) = trusted.iter().find(|name| !members.contains(name)) {
        return Err(Rejection::new(
            Code::BadArgument,
            format!("{} is not an organisation of this network", shown(stranger)),
        )
        .found(shown(stranger))
        .wanted(format!("some of {}", members.join(", ")))
        .next(did_you_mean(stranger, members.iter().map(String::as_str), "")));
    }
    Ok(trusted.into_iter().collect::<BTreeSet<_>>().into_iter().collect())
}

/// The members of the network now, sorted.
fn organisations(ctx: &mut Context<'_>) -> Result<Vec<String>, Rejection> {
    let names = ctx.call("msp", "organisations", &[])?;
    let names: BTreeSet<String> = store::parse(b"msp organisations", &names)?;
    Ok(names.into_iter().collect())
}

pub(crate) fn check_topic(topic: &str) -> Result<(), Rejection> {
    let valid =
        topic.len() <= TOPIC_BYTES_MAX && topic.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_ros_name));
    if valid {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "the topic is not a ROS 2 name")
        .found(shown(topic))
        .wanted("a leading slash and names of letters, digits and \"_\" between slashes, e.g. /cmd_vel"))
}

/// Types of messages, and those of calls.
fn check_type(type_name: &str) -> Result<(), Rejection> {
    let parts: Vec<&str> = type_name.split('/').collect();
    if type_name.len() <= TOPIC_BYTES_MAX
        && let [package, kind, name] = parts.as_slice()
        && (*kind == "msg" || is_called(type_name))
        && is_ros_name(package)
        && is_ros_name(name)
    {
        return Ok(());
    }
    let next = match parts.as_slice() {
        [package, name] if is_ros_name(package) && is_ros_name(name) => format!("did you mean {package}/msg/{name}?"),
        _ => String::new(),
    };
    Err(Rejection::new(Code::BadName, "the type is not a ROS 2 message type")
        .found(shown(type_name))
        .wanted("PACKAGE/msg/NAME, e.g. geometry_msgs/msg/Twist")
        .next(next))
}

fn is_ros_name(name: &str) -> bool {
    name.bytes().next().is_some_and(|first| first.is_ascii_alphabetic() || first == b'_')
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

/// The robot of that name, if there is one.
pub(crate) fn registered(ctx: &Context<'_>, name: &str) -> Result<Option<Robot>, Rejection> {
    robot::check_name(name)?;
    store::read(ctx, &store::robot_key(name))
}
