//! `cancel`: ending a task before it is done.

use crate::arguments::Arguments;
use crate::calls::reported_task;
use crate::lifecycle::task_ends;
use crate::lifecycle::{queue, tasks};
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::robot::Robot;
use crate::records::{line, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::TaskState;

/// `cancel ID`: by the submitter, or by an admin of the robot's owner.
pub(crate) fn cancel(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("cancel ID", args, 1, 1)?;
    let before = reported_task::find(ctx, args.number(0, "ID")?)?;
    let principal = Principal::of(ctx.submitter()?);
    let (id, who) = (before.task.id, principal.id());
    let robot: Option<Robot> = store::read(ctx, &store::robot_key(target::split(&before.task.service).0))?;
    if who != before.task.submitter && !robot.as_ref().is_some_and(|robot| principal.governs(robot)) {
        return Err(Rejection::new(Code::NotOwner, format!("{who} may not cancel task {id}"))
            .found(format!("role {} of {}", principal.role, principal.organisation))
            .wanted(format!("its submitter {}, or an admin of the robot's owner", before.task.submitter))
            .next(format!("ask {}", before.task.submitter)));
    }
    if !before.task.state.known().is_some_and(TaskState::is_open) {
        return Err(reported_task::not(&before, "open", "nothing needs to be done"));
    }
    let waits = line::of(ctx, &before.task.service, &before.place())?.is_some();
    let cancelled = task_ends::conclude(ctx, &before, TaskState::Cancelled, &format!("by {who}"))?;
    if waits && let Ok(target) = target::resolve(ctx, &before.task.service) {
        line::look_by(ctx, &target.id, ctx.block_time())?;
        queue::tell(ctx, decider, &target)?;
    }
    store::json(&tasks::whole(ctx, cancelled)?)
}
