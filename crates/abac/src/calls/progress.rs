//! `progress`: how many points of a running task were reached.

use crate::arguments::Arguments;
use crate::calls::reported_task;
use crate::lifecycle::task_ends;
use crate::lifecycle::{grants, tasks};
use crate::policy::decider::Decider;
use crate::records::{store, target, task};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{Task, TaskState};

/// `progress ID REACHED`: the number of points of a running task that were reached. It uses the grant. With the last point the task is
/// done.
pub(crate) fn progress(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("progress ID REACHED", args, 2, 2)?;
    let before = reported_task::reported(ctx, args.number(0, "ID")?)?;
    let reached = args.number(1, "REACHED")?;
    let Task { reached: least, total, .. } = before.task;
    if !(least..=total).contains(&reached) {
        return Err(args.bad(1, "REACHED", format!("{reached} of {total} points"), &format!("{least} to {total}")));
    }
    let mut after = before.clone();
    after.task.reached = reached;
    if reached == total {
        task::replace(ctx, &before, &after)?;
        let done = task_ends::conclude(ctx, &after, TaskState::Done, "")?;
        return store::json(&tasks::whole(ctx, done)?);
    }
    if reached > least {
        task::replace(ctx, &before, &after)?;
        tasks::tell(ctx, &after)?;
    }
    if let Some(holding) = tasks::grant_of(ctx, &after)? {
        let target = target::resolve(ctx, &after.task.service)?;
        grants::renew_by_use(ctx, decider, &target, &holding)?;
    }
    store::json(&tasks::whole(ctx, after)?)
}
