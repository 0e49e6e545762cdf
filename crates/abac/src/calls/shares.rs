//! `shares`: the shares in force.

use crate::arguments::Arguments;
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;
use ledger_contract::ShareEntry;

/// `shares [PAGE_JSON]`: those of every owner.
pub(crate) fn list(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    Arguments::new("shares [PAGE_JSON]", args, 0, 1)?;
    let paging = Paging::of("shares", args)?;
    paging.answer(&paging.page(ctx, b"policy/", |key, value| Ok(entry(key, value)))?)
}

fn entry(key: &[u8], text: &[u8]) -> Option<ShareEntry> {
    let (organisation, id) = std::str::from_utf8(key).ok()?.strip_prefix("policy/")?.split_once('/')?;
    ShareEntry::of(organisation, id, std::str::from_utf8(text).ok()?)
}
