//! `fail`: a running task cannot continue.

use crate::arguments::Arguments;
use crate::calls::reported_task;
use crate::lifecycle::task_ends;
use crate::lifecycle::tasks;
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::TaskState;

/// `fail ID REASON`: a running task cannot go on.
pub(crate) fn fail(ctx: &mut Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("fail ID REASON", args, 2, 2)?;
    let before = reported_task::reported(ctx, args.number(0, "ID")?)?;
    let failed = task_ends::conclude(ctx, &before, TaskState::Failed, args.text(1, "REASON")?)?;
    store::json(&tasks::whole(ctx, failed)?)
}
