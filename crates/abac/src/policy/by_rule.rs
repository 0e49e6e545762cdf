//! Rights by rule, for which no policy is asked for a permission.

use crate::records::grant;
use crate::records::principal::Principal;
use crate::records::robot::Robot;
use crate::records::target::Target;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::Direction;
use ledger_identity::Role;

/// The reason for which an admin of the owner needs no policy.
pub(crate) const OF_OWNER: &str = "an admin of the owner";

/// The reason for which somebody may stop a robot by rule: they are the robot itself, or hold one of its command services.
/// Only a `forbid` that names the action takes this right.
pub(crate) fn stops(ctx: &Context<'_>, principal: &Principal, robot: &Robot) -> Result<Option<String>, Rejection> {
    if principal.role == Role::Robot && principal.organisation == robot.organisation && principal.name == robot.name {
        return Ok(Some("the robot itself".to_owned()));
    }
    for service in robot.services.iter().filter(|service| service.direction == Direction::Command) {
        let id = Target::of(robot, service).id;
        if grant::held_by(ctx, &id, &principal.id())?.is_some() {
            return Ok(Some(format!("a holder of {id}")));
        }
    }
    Ok(None)
}
