//! Entering a robot in the ledger.

use crate::lifecycle::{ends, robots};
use crate::policy::decider::Decider;
use crate::records::robot;
use crate::records::robot::Robot;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::Released;

/// Enters a robot, new or in the place of what it was before; answers with the grants that end by it.
pub(crate) fn put(
    ctx: &mut Context<'_>,
    decider: &Decider,
    before: Option<&Robot>,
    mut robot: Robot,
) -> Result<Vec<Released>, Rejection> {
    enter(ctx, before, &mut robot)?;
    before.map_or(Ok(Vec::new()), |before| ends::robot_changed(ctx, decider, before, &robot))
}

/// Enters a robot without a look at its grants. The caller looks at them when all that belongs to the change is entered.
pub(crate) fn enter(ctx: &mut Context<'_>, before: Option<&Robot>, robot: &mut Robot) -> Result<(), Rejection> {
    if before.is_none() {
        robots::check_quota(ctx, &robot.organisation)?;
    }
    robots::check_budgets(ctx, robot)?;
    robot::write(ctx, robot)?;
    robots::tell(ctx, robot, if before.is_some() { "updated" } else { "registered" })
}
