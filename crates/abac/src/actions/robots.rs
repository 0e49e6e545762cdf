//! Registering robots and taking them out of service: `setup`, `remove`.

use super::{describe, end, queue, show};
use crate::arguments::Arguments;
use crate::policy::decider::Decider;
use crate::records::grant::{self, Holding};
use crate::records::robot::{self, Robot};
use crate::records::service::Target;
use crate::records::{reader, side_door, store};
use bytes::Bytes;
use ledger::Context;
use ledger::msp::{Quotas, quota_reached};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Reason, Released, RobotEvent};
use ledger_identity::{Identity, Role};

/// Most robots of one `setup`.
pub(crate) const ROBOTS_PER_SETUP_MAX: usize = 64;

/// `setup ROBOT_JSON...`: registers robots; by an admin of their owner. A robot that exists is refused: see `settings`.
pub(crate) fn setup(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("setup ROBOT_JSON...", args, 1, ROBOTS_PER_SETUP_MAX)?;
    let admin = admin(ctx, "register robots")?;
    let mut assets = Vec::new();
    for index in 0..args.rest(0).len() {
        let spec = describe::read_spec(args, index)?;
        if let Some(existing) = registered(ctx, &spec.name)? {
            let owned = check_owner(&existing, admin);
            owned.map_err(|refused| refused.next("choose another name for your robot"))?;
            return Err(exists(ctx, &existing)?);
        }
        let robot = describe::describe(ctx, decider, &admin.organisation, spec, None)?;
        put(ctx, decider, None, robot.clone())?;
        assets.push(show::asset(ctx, decider, &robot)?);
    }
    store::json(&assets)
}

fn exists(ctx: &Context<'_>, robot: &Robot) -> Result<Rejection, Rejection> {
    let mut services = Vec::new();
    for service in &robot.services {
        let holders: Vec<_> = grant::live(ctx, &robot.service_id(service))?;
        let holders: Vec<_> = holders.iter().map(|holding| holding.grant.holder.as_str()).collect();
        let held = if holders.is_empty() { String::new() } else { format!(", held by {}", holders.join(", ")) };
        services.push(format!("{} ({}{held})", robot.service_id(service), service.mode));
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
    let robot = robot::find(ctx, args.text(0, "ROBOT")?)?;
    check_owner(&robot, admin)?;
    let ending = take_out(ctx, &robot)?;
    let ended = end::end_all(ctx, ending)?;
    tell(ctx, &robot, "removed")?;
    store::json(&ended)
}

/// Takes a robot out of service; answers with the grants that end by that.
pub(crate) fn take_out(ctx: &mut Context<'_>, robot: &Robot) -> Result<Vec<(Holding, Reason)>, Rejection> {
    let mut ending = Vec::new();
    for Target { id, .. } in Target::all_of(robot) {
        queue::look_now(ctx, &id)?;
        ending.extend(grant::live(ctx, &id)?.into_iter().map(|holding| (holding, Reason::RobotRemoved)));
    }
    robot::remove(ctx, robot);
    side_door::forget(ctx, robot, None);
    reader::forget(ctx, robot, None)?;
    Ok(ending)
}

/// The robot of that name, if there is one.
pub(crate) fn registered(ctx: &Context<'_>, name: &str) -> Result<Option<Robot>, Rejection> {
    describe::check_name(name)?;
    store::read(ctx, &store::robot_key(name))
}

/// Enters a robot, new or in the place of what it was before; answers with the grants that end by it.
pub(crate) fn put(
    ctx: &mut Context<'_>,
    decider: &Decider,
    before: Option<&Robot>,
    mut robot: Robot,
) -> Result<Vec<Released>, Rejection> {
    if before.is_none() {
        check_quota(ctx, &robot.organisation)?;
    }
    robot::write(ctx, &mut robot)?;
    tell(ctx, &robot, if before.is_some() { "updated" } else { "registered" })?;
    before.map_or(Ok(Vec::new()), |before| end::robot_changed(ctx, decider, before, &robot))
}

/// Refuses one more robot of an organisation beyond its quota.
fn check_quota(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    let most = quotas(ctx, organisation)?.robots;
    if (robot::names_of(ctx, organisation).len() as u64) < most {
        return Ok(());
    }
    Err(quota_reached(organisation, "robots", most, "remove a robot that nobody uses: ledgerctl robot remove NAME"))
}

/// The quotas of an organisation.
pub(crate) fn quotas(ctx: &mut Context<'_>, organisation: &str) -> Result<Quotas, Rejection> {
    let quotas = ctx.call("msp", "quotas", &[Bytes::copy_from_slice(organisation.as_bytes())])?;
    store::parse(b"msp quotas", &quotas)
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
