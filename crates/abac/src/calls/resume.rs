//! `resume`: a stopped robot may be commanded again.

use crate::arguments::Arguments;
use crate::calls::emergency;
use crate::lifecycle::{capacity, looks};
use crate::policy::action::RobotAction;
use crate::policy::decider::Decider;
use crate::records::cancelled;
use crate::records::{stopped, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::EmergencyAnswer;

/// `resume ROBOT|* [REASON [CALL...]]`: it may be commanded again. Only the next contender in the queue gets it then. The stops that it
/// names (`ID:NOT_AFTER`) have no effect on these robots if they are ordered later.
pub(crate) fn resume(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("resume ROBOT|* [REASON [CALL...]]", args, 1, 2 + emergency::NAMED_MAX)?;
    let reason = emergency::reason(args)?;
    let named = emergency::named(args, 2)?;
    let by = ctx.submitter()?.id();
    let (mut robots, mut unchanged) = (Vec::new(), Vec::new());
    for robot in emergency::chosen(ctx, decider, args, RobotAction::Resume)? {
        let cancels = cancelled::cancel(ctx, &robot.name, &named)?;
        let was_stopped = stopped::of(ctx, &robot.name)?.is_some();
        if !was_stopped && !cancels {
            unchanged.push(robot.name);
            continue;
        }
        if was_stopped {
            stopped::remove(ctx, &robot.name);
            for target in emergency::commands(&robot) {
                looks::look_now(ctx, &target.id)?;
            }
        }
        if !capacity::is_full(ctx) {
            let told = emergency::told(&robot, &by, &reason)?;
            ctx.emit("resumed", &robot.name, told);
        }
        robots.push(robot.name);
    }
    store::json(&EmergencyAnswer { robots, unchanged, ended: Vec::new() })
}
