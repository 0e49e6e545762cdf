//! Deciding again about the grants on the robots of an organisation whose policies or robots have changed.
//!
//! There may be very many, and a decision may take many steps. So a call decides about as many as [`IN_CALL`] steps allow,
//! and every following block about some more, until none is left. Meanwhile nobody uses a grant that the new policies deny:
//! who publishes on a robot that is marked is decided about each time.

use super::follow_up::{Ending, FollowUp};
use super::settle::settle;
use crate::policy::decider::Decider;
use crate::policy::limits::STEPS_MAX;
use crate::policy::{decider, texts};
use crate::records::grant::Holding;
use crate::records::robot::Robot;
use crate::records::target::Target;
use crate::records::{grant, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{Reason, Released};

/// Steps of policies that one call takes to decide again.
const IN_CALL: u64 = 16 * STEPS_MAX;

/// Steps that the start of a block takes, for all organisations together.
pub(crate) const IN_BLOCK: u64 = STEPS_MAX;

/// A holder may acquire and publish: two decisions.
const DECISIONS: u64 = 2;

/// Most grants that are looked at for one organisation at the start of a block.
const GRANTS_MAX: u64 = 256;

/// Takes it more than a call does to decide again about the grants on a robot?
pub(crate) fn are_many(ctx: &Context<'_>, robot: &Robot) -> Result<bool, Rejection> {
    let most = IN_CALL / of_one(ctx, &robot.organisation)?;
    let most = usize::try_from(most).unwrap_or(usize::MAX);
    Ok(ctx.range(&store::grants_of_robot(&robot.name), most.saturating_add(1)).len() > most)
}

/// Steps to decide about one grant.
pub(crate) fn of_one(ctx: &Context<'_>, organisation: &str) -> Result<u64, Rejection> {
    let steps = texts::version(ctx, organisation)?.steps;
    Ok(steps.saturating_mul(DECISIONS).max(1))
}

/// The grants on a robot are to be decided again, if it has any.
pub(crate) fn mark(ctx: &mut Context<'_>, organisation: &str, robot: &str) {
    if ctx.range(&store::grants_of_robot(robot), 1).is_empty() {
        return;
    }
    ctx.put(&store::undecided_key(organisation, robot), Bytes::new());
}

/// Decides again in a call; answers with what ended and was told.
pub(crate) fn begin(ctx: &mut Context<'_>, decider: &Decider, organisation: &str) -> Result<Vec<Released>, Rejection> {
    let ending = some(ctx, decider, organisation, IN_CALL, u64::MAX)?;
    settle(ctx, ending)
}

/// Goes on at the start of a block.
pub(crate) fn go_on(ctx: &mut Context<'_>, decider: &Decider) -> Result<(), Rejection> {
    let organisations = organisations(ctx);
    let share = IN_BLOCK / organisations.len().max(1) as u64;
    for organisation in organisations {
        let ending = some(ctx, decider, &organisation, share, GRANTS_MAX)?;
        settle(ctx, ending)?;
    }
    Ok(())
}

/// Are grants on the robot of this service still to be decided again?
pub(crate) fn is_marked(ctx: &Context<'_>, target: &Target) -> bool {
    let Robot { organisation, name, .. } = &*target.robot;
    ctx.get(&store::undecided_key(organisation, name)).is_some()
}

/// Is anything left to be decided?
pub(crate) fn is_left(ctx: &Context<'_>) -> bool {
    !ctx.range(store::UNDECIDED, 1).is_empty()
}

/// The organisations of which something is left, in order.
fn organisations(ctx: &Context<'_>) -> Vec<String> {
    let (mut found, mut after) = (Vec::new(), None);
    while let Some((key, _)) = ctx.range_after(store::UNDECIDED, after.as_deref(), 1).pop() {
        let Some((organisation, _)) = store::parse_undecided_key(&key) else { break };
        // Behind all robots of this one: their names are UTF-8.
        after = Some([store::UNDECIDED, organisation.as_bytes(), b"/\xff"].concat());
        found.push(organisation.to_owned());
    }
    found
}

/// Decides about the next grants of an organisation, at least one: the live ones that its policies deny.
fn some(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    steps: u64,
    most: u64,
) -> Result<Vec<FollowUp>, Rejection> {
    let mut left = (steps / of_one(ctx, organisation)?).clamp(1, most);
    let mut ending = Vec::new();
    while left > 0
        && let Some((key, cursor)) = ctx.range(&store::undecided_key(organisation, ""), 1).pop()
    {
        let name = store::parse_undecided_key(&key).map(|(_, robot)| robot.to_owned()).unwrap_or_default();
        let prefix = store::grants_of_robot(&name);
        let after = (!cursor.is_empty()).then_some(&cursor[..]);
        let grants = ctx.range_after(&prefix, after, usize::try_from(left).unwrap_or(usize::MAX));
        let robot: Option<Robot> = store::read(ctx, &store::robot_key(&name))?;
        for (key, value) in &grants {
            ending.extend(decide(ctx, decider, robot.as_ref(), store::parse(key, value)?)?);
        }
        let looked_at = grants.len() as u64;
        match grants.last() {
            Some((last, _)) if looked_at == left => ctx.put(&key, last.clone()),
            _ => ctx.delete(&key),
        }
        left -= looked_at.min(left);
    }
    Ok(ending)
}

/// Decides about a live grant. One of a service that is gone has ended with it.
fn decide(
    ctx: &mut Context<'_>,
    decider: &Decider,
    robot: Option<&Robot>,
    holding: Holding,
) -> Result<Option<FollowUp>, Rejection> {
    let target = robot.and_then(|robot| Target::all_of(robot).find(|target| target.id == holding.grant.service));
    let Some(target) = target.filter(|_| holding.is_live(ctx.block_time())) else { return Ok(None) };
    let Ok(permit) = decider::may_keep(ctx, decider, &holding, &target) else {
        return Ok(Some(Ending::of_many(holding, Reason::Policy)));
    };
    let mut bound = holding.clone();
    bound.bind(&target.service, &permit.limits, permit.closes);
    if bound != holding {
        grant::replace(ctx, &holding, &bound)?;
    }
    Ok(None)
}
