//! Tasks that their submitter or the robot reports about.

use crate::lifecycle::tasks;
use crate::records::robot::Robot;
use crate::records::task::Kept;
use crate::records::{store, target, task};
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::Task;

/// A task that is kept.
///
/// # Errors
/// [`Code::NotFound`].
pub(crate) fn find(ctx: &Context<'_>, id: u64) -> Result<Kept, Rejection> {
    task::find(ctx, id)?.ok_or_else(|| {
        Rejection::new(Code::NotFound, format!("there is no task {id}"))
            .found("no task with this number, or one that ended long ago")
            .wanted("the number of a task")
            .next("ledgerctl task list shows the numbers; the event task reports how older ones ended")
    })
}

/// The running task that the caller reports about, with its service.
pub(crate) fn reported(ctx: &Context<'_>, id: u64) -> Result<Kept, Rejection> {
    let (kept, submitter) = (find(ctx, id)?, ctx.submitter()?);
    let name = target::split(&kept.task.service).0;
    let robot: Option<Robot> = store::read(ctx, &store::robot_key(name))?;
    if submitter.id() != kept.task.submitter && !robot.as_ref().is_some_and(|robot| robot.is(submitter)) {
        return Err(Rejection::new(Code::NotOwner, format!("{} may not report on task {id}", submitter.id()))
            .found(format!("role {} of {}", submitter.role, submitter.organisation))
            .wanted(format!("its submitter {}, or the robot {name} itself", kept.task.submitter))
            .next(format!("ask {}", kept.task.submitter)));
    }
    if tasks::grant_of(ctx, &kept)?.is_none() {
        return Err(not(&kept, "running", "only a running task can progress or fail; cancel others"));
    }
    Ok(kept)
}

pub(crate) fn not(kept: &Kept, wanted: &str, next: &str) -> Rejection {
    let Task { id, state, reason, .. } = &kept.task;
    let why = if reason.is_empty() { String::new() } else { format!(": {reason}") };
    Rejection::new(Code::BadArgument, format!("task {id} is not {wanted}"))
        .found(format!("{state}{why}"))
        .wanted(format!("a task that is {wanted}"))
        .next(next)
}
