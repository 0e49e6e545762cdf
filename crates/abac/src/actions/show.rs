//! Robots and services as everybody sees them: `robots`, `robot`, `service`.

use super::contest::Contest;
use super::{hold, task_list};
use crate::arguments::Arguments;
use crate::policy::decider::Decider;
use crate::records::robot::{self, Robot};
use crate::records::service::{self, Target};
use crate::records::{grant, last, line, pending, side_door, stopped, store};
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;
use ledger_contract::{Declaration, Direction, Grant, RobotAsset, ServiceState};

/// Most publishers that `latest` tells.
const LATEST_MAX: usize = 64;

/// `robots [PAGE_JSON]`
pub(crate) fn robots(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("robots [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("robots", args)?;
    let read = |key: &[u8], value: &[u8]| asset(ctx, decider, &store::parse(key, value)?).map(Some);
    paging.answer(&paging.page(ctx, b"robot/", read)?)
}

/// `robot NAME`
pub(crate) fn robot(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("robot NAME", args, 1, 1)?;
    store::json(&asset(ctx, decider, &robot::find(ctx, args.text(0, "NAME")?)?)?)
}

/// `declare ROBOT`: writes the robot's record once more, so that voters certify this block, and with it the answer. So a
/// reader that believes no single node learns how the robot stands.
pub(crate) fn declare(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("declare ROBOT", args, 1, 1)?;
    let robot = robot::find(ctx, args.text(0, "ROBOT")?)?;
    store::write(ctx, &store::robot_key(&robot.name), &robot)?;
    let mut grants = Vec::new();
    for service in &robot.services {
        grants.extend(hold::live(ctx, decider, &Target::of(&robot, service))?);
    }
    let told = asset(ctx, decider, &robot)?;
    let tasks = task_list::running(ctx, &grants)?;
    store::json(&Declaration { robot: told, grants, tasks })
}

/// `service SERVICE`
pub(crate) fn service(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("service SERVICE", args, 1, 1)?;
    store::json(&state(ctx, decider, service::resolve(ctx, args.text(0, "SERVICE")?)?)?)
}

/// `line SERVICE`: who holds a service, and who waits for it.
pub(crate) fn line(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("line SERVICE", args, 1, 1)?;
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let asking = pending::all(ctx, &target.id)?;
    store::json(&Contest::of(ctx, &target)?.told(decider.rules.of(&target)?, &asking))
}

/// `latest SERVICE`: where the last message of each publisher is, for those who come late. The messages themselves are in
/// their blocks.
pub(crate) fn latest(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("latest SERVICE", args, 1, 1)?;
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let mut all = last::all(ctx, &target.id)?;
    all.sort_by_key(|last| std::cmp::Reverse(last.height));
    all.truncate(LATEST_MAX);
    store::json(&all)
}

/// A robot as clients see it.
pub(crate) fn asset(ctx: &Context<'_>, decider: &Decider, robot: &Robot) -> Result<RobotAsset, Rejection> {
    let services = robot
        .services
        .iter()
        .map(|service| state(ctx, decider, Target::of(robot, service)))
        .collect::<Result<Vec<_>, Rejection>>()?;
    let topics = |direction| {
        let of_direction = services.iter().filter(|service| service.direction == direction);
        of_direction.map(|service| service.topic.as_str()).collect::<Vec<_>>().join(",")
    };
    let operated = services.iter().find(|s| s.direction == Direction::Command && !s.holder.is_empty());
    Ok(RobotAsset {
        name: robot.name.clone(),
        sub_topic: topics(Direction::Command),
        pub_topic: topics(Direction::Feed),
        operator: operated.map(|service| service.holder.clone()).unwrap_or_default(),
        under_operation: operated.is_some(),
        organisation: robot.organisation.clone(),
        attribute_required: robot.attribute_required.clone(),
        trusted: robot.trusted.clone(),
        services,
        attributes: robot.attributes.clone(),
        stopped: stopped::of(ctx, &robot.name)?,
    })
}

/// A service with who holds it now.
fn state(ctx: &Context<'_>, decider: &Decider, target: Target) -> Result<ServiceState, Rejection> {
    let grants: Vec<Grant> = grant::live(ctx, &target.id)?.into_iter().map(|holding| holding.grant).collect();
    let capabilities = Some(decider.rules.capabilities(&target)?.into());
    let epoch = grant::newest_epoch(ctx, &target.id)?;
    let readers = Target::of_readers(&target.robot, &target.service);
    let readers = readers.map_or(Ok(Vec::new()), |places| grant::live(ctx, &places.id))?;
    let waiting = line::all(ctx, &target.id)?.len() as u64;
    let side_door = side_door::of(ctx, &target.id)?;
    let Target { robot, service, id } = target;
    Ok(ServiceState {
        service: id,
        robot: robot.name.clone(),
        organisation: robot.organisation.clone(),
        topic: service.topic,
        type_name: service.type_name,
        mode: service.mode,
        direction: service.direction.into(),
        max_age_ms: service.max_age_ms,
        lease_ms: service.lease_ms,
        lease_ms_max: service.lease_ms_max,
        stop_hex: service.stop_hex,
        sharing: service.sharing,
        attributes: service.attributes,
        waiting,
        holder: grants.first().map(|grant| grant.holder.clone()).unwrap_or_default(),
        epoch,
        expires: grants.first().map_or(0, |grant| grant.expires),
        holders: grants.into_iter().map(|grant| grant.holder).collect(),
        readers: readers.into_iter().map(|holding| holding.grant.holder).collect(),
        side_door,
        capabilities,
    })
}
