//! Robots and services as everybody sees them.

use crate::policy::decider::Decider;
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::records::{grant, line, side_door, stopped};
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{Direction, Grant, RobotAsset, ServiceState};

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
        version: robot.version.to_string(),
    })
}

/// A service with who holds it now.
pub(crate) fn state(ctx: &Context<'_>, decider: &Decider, target: Target) -> Result<ServiceState, Rejection> {
    let grants: Vec<Grant> = grant::live(ctx, &target.id)?.into_iter().map(|holding| holding.grant).collect();
    let capabilities = decider.rules.capabilities(&target)?.into();
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
