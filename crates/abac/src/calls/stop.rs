//! `stop`: no one commands a robot until it is resumed.

use crate::arguments::Arguments;
use crate::calls::emergency;
use crate::lifecycle::capacity;
use crate::lifecycle::follow_up::Ending;
use crate::lifecycle::settle::settle;
use crate::policy::action::RobotAction;
use crate::policy::decider::Decider;
use crate::records::{cancelled, grant, stopped, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{EmergencyAnswer, Reason, Stopped};

/// `stop ROBOT|* [REASON]`: ends every grant of its command services, and gives none until it is resumed.
pub(crate) fn stop(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("stop ROBOT|* [REASON]", args, 1, 2)?;
    let reason = emergency::reason(args)?;
    let by = ctx.submitter()?.id();
    let (mut robots, mut unchanged, mut ending, mut cancelled) = (Vec::new(), Vec::new(), Vec::new(), false);
    for robot in emergency::chosen(ctx, decider, args, RobotAction::Stop)? {
        if cancelled::has(ctx, &robot.name, &ctx.transaction())? {
            cancelled = true;
            continue;
        }
        if stopped::of(ctx, &robot.name)?.is_some() {
            unchanged.push(robot.name);
            continue;
        }
        let stop = Stopped { by: by.clone(), reason: reason.clone(), since: ctx.block_time() };
        stopped::put(ctx, &robot.name, &stop)?;
        for target in emergency::commands(&robot) {
            ending.extend(
                grant::live(ctx, &target.id)?.into_iter().map(|holding| Ending::of_many(holding, Reason::Stopped)),
            );
        }
        // Robots beyond the room in the event are stopped all the same.
        if !capacity::is_full(ctx) {
            let told = emergency::told(&robot, &by, &reason)?;
            ctx.emit("stopped", &robot.name, told);
        }
        robots.push(robot.name);
    }
    if cancelled && robots.is_empty() && unchanged.is_empty() {
        return Err(Rejection::new(Code::Refused, "a resume cancelled this stop before it was ordered")
            .found("its id among the cancelled ones")
            .wanted("a stop signed after the resume")
            .next("repeat the stop if the robot must stay stopped"));
    }
    let ended = settle(ctx, ending)?;
    store::json(&EmergencyAnswer { robots, unchanged, ended })
}
