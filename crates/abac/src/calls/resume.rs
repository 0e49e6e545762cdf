//! `resume`: a stopped robot may be commanded again.

use crate::arguments::Arguments;
use crate::calls::emergency;
use crate::lifecycle::{capacity, looks};
use crate::policy::action::RobotAction;
use crate::policy::decider::Decider;
use crate::records::{stopped, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::EmergencyAnswer;

/// `resume ROBOT|* [REASON]`: it may be commanded again. Nobody has it then but whose turn it is in line.
pub(crate) fn resume(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("resume ROBOT|* [REASON]", args, 1, 2)?;
    let reason = emergency::reason(args)?;
    let by = ctx.submitter()?.id();
    let (mut robots, mut unchanged) = (Vec::new(), Vec::new());
    for robot in emergency::chosen(ctx, decider, args, RobotAction::Resume)? {
        if stopped::of(ctx, &robot.name)?.is_none() {
            unchanged.push(robot.name);
            continue;
        }
        stopped::remove(ctx, &robot.name);
        for target in emergency::commands(&robot) {
            looks::look_now(ctx, &target.id)?;
        }
        if !capacity::is_full(ctx) {
            let told = emergency::told(&robot, &by, &reason)?;
            ctx.emit("resumed", &robot.name, told);
        }
        robots.push(robot.name);
    }
    store::json(&EmergencyAnswer { robots, unchanged, ended: Vec::new() })
}
