//! Robots: what an organisation registers, and the asset of the paper.

use crate::arguments::{Arguments, shown};
use crate::authorize::Decider;
use crate::grant::{self, Holding};
use crate::nearest::did_you_mean;
use crate::revoke;
use crate::service::{Service, Target};
use crate::store;
use bytes::Bytes;
use ledger::Context;
use ledger_contract::{Direction, Reason, Released, RobotAsset, RobotEvent, RobotSpec, ServiceSpec};
use ledger_hash::Hash;
use ledger_identity::{Identity, Role};
use ledger_rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Most robots of a network.
pub(crate) const ROBOTS_MAX: usize = 1024;
/// Most services of one robot.
pub(crate) const SERVICES_MAX: usize = 64;
/// Longest robot name, in bytes.
const NAME_BYTES_MAX: usize = 64;
/// Longest required attribute with its value, in bytes.
const ATTRIBUTE_BYTES_MAX: usize = 256;
/// Most organisations that a robot trusts.
const TRUSTED_MAX: usize = 256;
/// Longest JSON of one robot in `setup`, in bytes.
const SPEC_BYTES_MAX: usize = 256 * 1024;
/// Most robots of one `setup`.
pub(crate) const ROBOTS_PER_SETUP_MAX: usize = 64;

/// A registered robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Robot {
    pub(crate) name: String,
    /// The organisation that owns it.
    pub(crate) organisation: String,
    /// `KEY=VALUE`.
    pub(crate) attribute_required: String,
    /// Sorted.
    pub(crate) trusted: Vec<String>,
    /// In the order of the owner's description.
    pub(crate) services: Vec<Service>,
    /// Hash over all of the above: names this state of the robot in caches.
    pub(crate) version: Hash,
}

impl Robot {
    /// The id of one of its services.
    pub(crate) fn service_id(&self, service: &Service) -> String {
        format!("{}{}", self.name, service.topic)
    }

    /// Name and value of the required attribute.
    pub(crate) fn required(&self) -> (&str, &str) {
        self.attribute_required.split_once('=').unwrap_or((&self.attribute_required, "true"))
    }

    /// The robot as clients see it.
    pub(crate) fn asset(&self, ctx: &Context<'_>) -> Result<RobotAsset, Rejection> {
        let services = self
            .services
            .iter()
            .map(|service| Target::of(self, service).state(ctx))
            .collect::<Result<Vec<_>, Rejection>>()?;
        let topics = |direction| {
            let of_direction = services.iter().filter(|service| service.direction == direction);
            of_direction.map(|service| service.topic.as_str()).collect::<Vec<_>>().join(",")
        };
        let operated = services.iter().find(|s| s.direction == Direction::Command && !s.holder.is_empty());
        Ok(RobotAsset {
            name: self.name.clone(),
            sub_topic: topics(Direction::Command),
            pub_topic: topics(Direction::Feed),
            operator: operated.map(|service| service.holder.clone()).unwrap_or_default(),
            under_operation: operated.is_some(),
            organisation: self.organisation.clone(),
            attribute_required: self.attribute_required.clone(),
            trusted: self.trusted.clone(),
            services,
        })
    }
}

/// All registered robots in order of their names.
pub(crate) fn all(ctx: &Context<'_>) -> Result<Vec<Robot>, Rejection> {
    ctx.range(b"robot/", ROBOTS_MAX).iter().map(|(key, value)| store::parse(key, value)).collect()
}

/// The robot of that name.
///
/// # Errors
/// [`Code::UnknownRobot`] with the nearest name.
pub(crate) fn find(ctx: &Context<'_>, name: &str) -> Result<Robot, Rejection> {
    if name.len() <= NAME_BYTES_MAX
        && let Some(robot) = store::read(ctx, &store::robot_key(name))?
    {
        return Ok(robot);
    }
    let keys = ctx.range(b"robot/", ROBOTS_MAX);
    let names = keys.iter().filter_map(|(key, _)| std::str::from_utf8(key).ok()?.strip_prefix("robot/"));
    Err(Rejection::new(Code::UnknownRobot, format!("no robot {} is registered", shown(name)))
        .found(shown(name))
        .wanted("the name of a registered robot")
        .next(did_you_mean(name, names, "ledgerctl robot list")))
}

/// `robots`
pub(crate) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("robots", args, 0, 0)?;
    let assets = all(ctx)?.iter().map(|robot| robot.asset(ctx)).collect::<Result<Vec<_>, Rejection>>()?;
    store::json(&assets)
}

/// `robot NAME`
pub(crate) fn show(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("robot NAME", args, 1, 1)?;
    store::json(&find(ctx, args.text(0, "NAME")?)?.asset(ctx)?)
}

/// Reads a description from one argument.
pub(crate) fn read_spec(args: Arguments<'_>, index: usize) -> Result<RobotSpec, Rejection> {
    let text = args.document(index, "ROBOT_JSON", SPEC_BYTES_MAX)?;
    serde_json::from_str(text).map_err(|fault| {
        args.bad(index, "ROBOT_JSON", fault.to_string(), "JSON of a robot: name, attribute_required, services")
    })
}

/// `setup ROBOT_JSON...`: registers robots; by an admin of their owner. What exists is refused: see `settings`.
pub(crate) fn setup(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("setup ROBOT_JSON...", args, 1, ROBOTS_PER_SETUP_MAX)?;
    let admin = admin(ctx, "register robots")?;
    let mut assets = Vec::new();
    for index in 0..args.rest(0).len() {
        let spec = read_spec(args, index)?;
        if let Some(existing) = registered(ctx, &spec.name)? {
            let owned = check_owner(&existing, admin);
            owned.map_err(|refused| refused.next("choose another name for your robot"))?;
            return Err(exists(ctx, &existing)?);
        }
        let robot = describe(ctx, &admin.organisation, spec, None)?;
        put(ctx, decider, None, robot.clone())?;
        assets.push(robot.asset(ctx)?);
    }
    store::json(&assets)
}

fn exists(ctx: &Context<'_>, robot: &Robot) -> Result<Rejection, Rejection> {
    let mut services = Vec::new();
    for service in &robot.services {
        let holders: Vec<_> = grant::live(ctx, &robot.service_id(service))?;
        let holders: Vec<_> = holders.iter().map(|holding| holding.grant.holder.as_str()).collect();
        let held = if holders.is_empty() { String::new() } else { format!(", held by {}", holders.join(", ")) };
        services.push(format!("{} ({}{held})", robot.service_id(service), grant::mode_name(service.mode)));
    }
    let name = &robot.name;
    Ok(Rejection::new(Code::AlreadyExists, format!("robot {name} is registered already"))
        .found(format!("robot of {} with {}", robot.organisation, services.join(", ")))
        .wanted("a name that no robot has")
        .next(format!(
            "to change it: ledgerctl robot set {name} KEY=VALUE; to replace all of it: ledgerctl robot add {name} --replace …"
        )))
}

/// `remove ROBOT`: takes a robot out of service; by an admin of its owner. Its epochs are kept.
pub(crate) fn remove(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("remove ROBOT", args, 1, 1)?;
    let admin = admin(ctx, "remove robots")?;
    let robot = find(ctx, args.text(0, "ROBOT")?)?;
    check_owner(&robot, admin)?;
    let ending = take_out(ctx, &robot)?;
    let ended = revoke::end_all(ctx, ending)?;
    tell(ctx, &robot, "removed")?;
    store::json(&ended)
}

/// Takes a robot out of service; answers with the grants that end by that.
pub(crate) fn take_out(ctx: &mut Context<'_>, robot: &Robot) -> Result<Vec<(Holding, Reason)>, Rejection> {
    let mut ending = Vec::new();
    for service in &robot.services {
        ending.extend(grant::live(ctx, &robot.service_id(service))?.into_iter().map(|h| (h, Reason::RobotRemoved)));
    }
    ctx.delete(&store::robot_key(&robot.name));
    Ok(ending)
}

/// The robot of that name, if there is one.
pub(crate) fn registered(ctx: &Context<'_>, name: &str) -> Result<Option<Robot>, Rejection> {
    check_name(name)?;
    store::read(ctx, &store::robot_key(name))
}

/// Checks a description and fills in what it leaves out. Without another word a robot trusts whom it trusted before.
pub(crate) fn describe(
    ctx: &mut Context<'_>,
    organisation: &str,
    spec: RobotSpec,
    before: Option<&Robot>,
) -> Result<Robot, Rejection> {
    let services = check_services(&spec.name, spec.services)?;
    let trusted = match (spec.trusted, before) {
        (Some(trusted), _) => check_trusted(ctx, trusted)?,
        (None, Some(robot)) => robot.trusted.clone(),
        (None, None) => organisations(ctx)?,
    };
    Ok(Robot {
        name: spec.name,
        organisation: organisation.to_owned(),
        attribute_required: check_attribute(&spec.attribute_required)?,
        trusted,
        services,
        version: Hash::ZERO,
    })
}

/// Enters a robot, new or in the place of what it was before; answers with the grants that end by it.
pub(crate) fn put(
    ctx: &mut Context<'_>,
    decider: &Decider,
    before: Option<&Robot>,
    mut robot: Robot,
) -> Result<Vec<Released>, Rejection> {
    if before.is_none() && ctx.range(b"robot/", ROBOTS_MAX).len() >= ROBOTS_MAX {
        return Err(Rejection::new(Code::LimitExceeded, "the network has no room for another robot")
            .found(format!("{ROBOTS_MAX} robots"))
            .wanted(format!("at most {ROBOTS_MAX}")));
    }
    robot.version = Hash::ZERO;
    robot.version = Hash::of(&[&store::json(&robot)?]);
    store::write(ctx, &store::robot_key(&robot.name), &robot)?;
    tell(ctx, &robot, if before.is_some() { "updated" } else { "registered" })?;
    before.map_or(Ok(Vec::new()), |before| revoke::robot_changed(ctx, decider, before, &robot))
}

/// Tells that a robot was registered, updated or removed.
pub(crate) fn tell(ctx: &mut Context<'_>, robot: &Robot, change: &str) -> Result<(), Rejection> {
    let event =
        RobotEvent { robot: robot.name.clone(), organisation: robot.organisation.clone(), change: change.to_owned() };
    ctx.emit("robot", &robot.name, store::json(&event)?);
    Ok(())
}

/// The submitter, if they are an admin of their organisation.
///
/// # Errors
/// [`Code::NotAdmin`].
pub(crate) fn admin<'a>(ctx: &Context<'a>, what: &str) -> Result<&'a Identity, Rejection> {
    let submitter = ctx.submitter()?;
    if submitter.role == Role::Admin {
        return Ok(submitter);
    }
    Err(Rejection::new(Code::NotAdmin, format!("{} may not {what}", submitter.id()))
        .found(format!("role {}", submitter.role))
        .wanted("role admin")
        .next(format!("ask an admin of {}", submitter.organisation)))
}

/// Refuses who is no admin of the robot's owner.
///
/// # Errors
/// [`Code::NotOwner`].
pub(crate) fn check_owner(robot: &Robot, admin: &Identity) -> Result<(), Rejection> {
    if robot.organisation == admin.organisation {
        return Ok(());
    }
    Err(Rejection::new(Code::NotOwner, format!("robot {} belongs to {}", robot.name, robot.organisation))
        .found(format!("{}, an admin of {}", admin.id(), admin.organisation))
        .wanted(format!("an admin of {}", robot.organisation))
        .next(format!("ask an admin of {}", robot.organisation)))
}

fn check_name(name: &str) -> Result<(), Rejection> {
    let allowed = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-' | b'.');
    if (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(allowed) {
        return Ok(());
    }
    Err(Rejection::new(Code::BadName, "the name of the robot is not usable")
        .found(shown(name))
        .wanted(format!("1 to {NAME_BYTES_MAX} letters, digits, \"_\", \"-\" and \".\""))
        .next("choose another name"))
}

pub(crate) fn check_attribute(required: &str) -> Result<String, Rejection> {
    let (key, value) = required.split_once('=').unwrap_or((required, "true"));
    if key.is_empty() || required.len() > ATTRIBUTE_BYTES_MAX || required.chars().any(char::is_control) {
        return Err(Rejection::new(Code::BadArgument, "attribute_required is not usable")
            .found(shown(required))
            .wanted(format!("KEY or KEY=VALUE, at most {ATTRIBUTE_BYTES_MAX} bytes"))
            .next("name the attribute that users must have; ledgerctl identity list shows attributes"));
    }
    Ok(format!("{key}={value}"))
}

fn check_services(robot: &str, specs: Vec<ServiceSpec>) -> Result<Vec<Service>, Rejection> {
    if !(1..=SERVICES_MAX).contains(&specs.len()) {
        return Err(Rejection::new(Code::BadArgument, format!("robot {robot} has no usable number of services"))
            .found(format!("{} services", specs.len()))
            .wanted(format!("1 to {SERVICES_MAX}")));
    }
    let services = specs.into_iter().map(Service::check).collect::<Result<Vec<_>, _>>()?;
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
            format!("{} is no organisation of this network", shown(stranger)),
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
