//! Tasks as everybody sees them: `tasks`, `task`, and the running ones of a robot.

use super::tasks;
use crate::arguments::Arguments;
use crate::records::store;
use crate::records::task::{self, Kept};
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;
use ledger_contract::{Grant, NEXT_MAX, RunningTask, Task};

/// A task with its points.
pub(crate) fn whole(ctx: &Context<'_>, kept: Kept) -> Result<Task, Rejection> {
    let points = task::points(ctx, kept.task.id)?;
    Ok(Task { points, ..kept.task })
}

/// `task ID`
pub(crate) fn task(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("task ID", args, 1, 1)?;
    store::json(&whole(ctx, tasks::find(ctx, args.number(0, "ID")?)?)?)
}

/// `tasks [PAGE_JSON]`: all that are kept, the oldest first, without their points.
pub(crate) fn tasks(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let read = |key: &[u8], value: &[u8]| store::parse::<Kept>(key, value).map(|kept| kept.task);
    Arguments::new("tasks [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("tasks", args)?;
    paging.answer(&paging.page(ctx, store::TASK, |key, value| read(key, value).map(Some))?)
}

/// The tasks that these grants serve.
pub(crate) fn running(ctx: &Context<'_>, grants: &[Grant]) -> Result<Vec<RunningTask>, Rejection> {
    let mut running = Vec::new();
    for id in grants.iter().filter_map(|grant| grant.task) {
        if let Some(Kept { task, .. }) = task::find(ctx, id)? {
            let Task { id, service, frame, reached, .. } = task;
            let skipped = usize::try_from(reached).unwrap_or(usize::MAX);
            let next = task::points(ctx, id)?.into_iter().skip(skipped).take(NEXT_MAX).collect();
            running.push(RunningTask { id, service, frame, reached, next });
        }
    }
    Ok(running)
}
