//! `latest`: where the last messages of a service are.

use crate::arguments::Arguments;
use crate::records::{last, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// Most publishers that `latest` tells.
const LATEST_MAX: usize = 64;

/// `latest SERVICE`: where the last message of each publisher is, for those who come late. The messages themselves are in
/// their blocks.
pub(crate) fn latest(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("latest SERVICE", args, 1, 1)?;
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let mut all = last::all(ctx, &target.id)?;
    all.sort_by_key(|last| std::cmp::Reverse(last.height));
    all.truncate(LATEST_MAX);
    store::json(&all)
}
