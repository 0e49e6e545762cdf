//! `robots`: the registered robots.

use crate::arguments::Arguments;
use crate::calls::views;
use crate::policy::decider::Decider;
use crate::records::store;
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;

/// `robots [PAGE_JSON]`
pub(crate) fn robots(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("robots [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("robots", args)?;
    let read = |key: &[u8], value: &[u8]| views::asset(ctx, decider, &store::parse(key, value)?).map(Some);
    paging.answer(&paging.page(ctx, b"robot/", read)?)
}
