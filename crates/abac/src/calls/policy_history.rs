//! `policy_history`: the sets of an organisation.

use crate::arguments::Arguments;
use crate::records::{policy_set, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `policy_history ORGANISATION`: its sets that are kept, the newest first.
pub(crate) fn history(ctx: &Context<'_>, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("policy_history ORGANISATION", args, 1, 1)?;
    store::json(&policy_set::all(ctx, args.text(0, "ORGANISATION")?)?)
}
