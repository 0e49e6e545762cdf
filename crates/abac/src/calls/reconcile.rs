//! `reconcile`: several robots and the policies of their owner in one step.

use crate::arguments::Arguments;
use crate::calls::policy::apply;
use crate::calls::{description, robot_change, views};
use crate::lifecycle::settle::settle;
use crate::lifecycle::{access, ends, registration, robots};
use crate::policy::decider::Decider;
use crate::policy::texts;
use crate::policy::texts::TextSet;
use crate::records::robot::Robot;
use crate::records::{robot, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{FleetChange, FleetPlan, PolicyDiff, RemovedRobot, RobotChange, RobotSpec};

/// Longest plan, in bytes.
const PLAN_BYTES_MAX: usize = 4 * 1024 * 1024;
/// A robot as it was, unless it is new, and as it is to be, unless it goes.
type BeforeAndAfter = (Option<Robot>, Option<Robot>);

/// Most robots of one plan.
const ROBOTS_MAX: usize = 256;

/// `reconcile PLAN_JSON`: robots, and the policies of their owner, as they are to be; by an admin of the owner. Grants are decided
/// about when all of it is entered: none ends because of a state between.
pub(crate) fn reconcile(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("reconcile PLAN_JSON", args, 1, 1)?;
    let wanted = "JSON with some of robots, removed (of name and base) and policies (as in policy apply)";
    let plan: FleetPlan = serde_json::from_str(args.document(0, "PLAN_JSON", PLAN_BYTES_MAX)?)
        .map_err(|fault| args.bad(0, "PLAN_JSON", fault.to_string(), wanted))?;
    let count = plan.robots.len() + plan.removed.len();
    if count > ROBOTS_MAX {
        return Err(args.bad(0, "PLAN_JSON", format!("{count} robots"), &format!("at most {ROBOTS_MAX} robots")));
    }
    let organisation = robots::admin(ctx, "change robots and policies")?.organisation.clone();
    let set = TextSet::of(texts::in_force(ctx, &organisation)?)?;
    let mut change = FleetChange::default();
    let mut pairs = Vec::new();
    for gone in &plan.removed {
        let robot = taken_out(ctx, gone, &mut change)?;
        pairs.push((Some(robot), None));
    }
    for spec in plan.robots {
        pairs.push(entered(ctx, decider, &organisation, spec)?);
    }
    if let Some(draft) = plan.policies {
        let changed = apply::apply(ctx, decider, &[store::json(&draft)?])?;
        change.policies = Some(store::parse(b"policy apply", &changed)?);
    }
    for (before, after) in &pairs {
        let Some(after) = after else { continue };
        let changed = before.as_ref().map_or_else(Vec::new, |before| robot_change::differences(before, after));
        let ended = match before {
            Some(before) => ends::robot_changed(ctx, decider, before, after)?,
            None => Vec::new(),
        };
        change.robots.push(RobotChange { robot: views::asset(ctx, decider, after)?, changed, ended });
    }
    if ctx.is_query() {
        let then = TextSet::of(texts::in_force(ctx, &organisation)?)?;
        let pairs = with_unchanged(ctx, &organisation, pairs, change.policies.is_some())?;
        let (mut diff, time) = (PolicyDiff { organisation, ..PolicyDiff::default() }, ctx.block_time());
        access::compare(ctx, decider, &pairs, (&set, &then), time, &mut diff)?;
        change.diff = Some(diff);
    }
    store::json(&change)
}

/// Takes a robot out of service.
fn taken_out(ctx: &mut Context<'_>, gone: &RemovedRobot, change: &mut FleetChange) -> Result<Robot, Rejection> {
    let admin = robots::admin(ctx, "remove robots")?;
    let robot = robot::find(ctx, &gone.name)?;
    robots::check_owner(&robot, admin)?;
    description::check_base(&gone.name, Some(&robot), Some(&gone.base))?;
    let ending = robots::take_out(ctx, &robot)?;
    change.removed.extend(settle(ctx, ending)?);
    robots::tell(ctx, &robot, "removed")?;
    Ok(robot)
}

/// Enters a robot as the plan has it, with what it was before.
fn entered(
    ctx: &mut Context<'_>,
    decider: &Decider,
    organisation: &str,
    spec: RobotSpec,
) -> Result<BeforeAndAfter, Rejection> {
    let admin = robots::admin(ctx, "change robots")?;
    let before = description::registered(ctx, &spec.name)?;
    match &before {
        Some(robot) => robots::check_owner(robot, admin)?,
        None => description::check_look(ctx, &spec.name)?,
    }
    description::check_base(&spec.name, before.as_ref(), spec.base.as_deref())?;
    let mut after = description::describe(ctx, decider, organisation, spec, before.as_ref())?;
    let is_same = before.as_ref().is_some_and(|before| robot_change::differences(before, &after).is_empty());
    if !is_same {
        registration::enter(ctx, before.as_ref(), &mut after)?;
        return Ok((before, Some(after)));
    }
    Ok((before.clone(), before))
}

/// The robots of a plan, and where policies change all others of the organisation.
fn with_unchanged(
    ctx: &Context<'_>,
    organisation: &str,
    mut pairs: Vec<BeforeAndAfter>,
    all: bool,
) -> Result<Vec<BeforeAndAfter>, Rejection> {
    if all {
        let is_in_plan =
            |name: &str| pairs.iter().flat_map(|(now, then)| [now, then]).flatten().any(|one| one.name == name);
        let others = robot::all(ctx)?.into_iter().filter(|robot| robot.organisation == organisation);
        let others: Vec<Robot> = others.filter(|robot| !is_in_plan(&robot.name)).collect();
        pairs.extend(others.into_iter().map(|robot| (Some(robot.clone()), Some(robot))));
    }
    Ok(pairs)
}
