//! `task`: one task with its points.

use crate::arguments::Arguments;
use crate::calls::reported_task;
use crate::lifecycle::tasks;
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `task ID`
pub(crate) fn task(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("task ID", args, 1, 1)?;
    store::json(&tasks::whole(ctx, reported_task::find(ctx, args.number(0, "ID")?)?)?)
}
