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
    if before.is_none() {
        robots::check_quota(ctx, &robot.organisation)?;
    }
    robots::check_budgets(ctx, &robot)?;
    robot::write(ctx, &mut robot)?;
    robots::tell(ctx, &robot, if before.is_some() { "updated" } else { "registered" })?;
    before.map_or(Ok(Vec::new()), |before| ends::robot_changed(ctx, decider, before, &robot))
}
