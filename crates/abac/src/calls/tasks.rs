//! `tasks`: the tasks that are kept.

use crate::arguments::Arguments;
use crate::records::store;
use crate::records::task::Kept;
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;

/// `tasks [PAGE_JSON]`: all that are kept, the oldest first, without their points.
pub(crate) fn tasks(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let read = |key: &[u8], value: &[u8]| store::parse::<Kept>(key, value).map(|kept| kept.task);
    Arguments::new("tasks [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("tasks", args)?;
    paging.answer(&paging.page(ctx, store::TASK, |key, value| read(key, value).map(Some))?)
}
