//! `service`: one service.

use crate::arguments::Arguments;
use crate::calls::views;
use crate::policy::decider::Decider;
use crate::records::{store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `service SERVICE`
pub(crate) fn service(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("service SERVICE", args, 1, 1)?;
    store::json(&views::state(ctx, decider, target::resolve(ctx, args.text(0, "SERVICE")?)?)?)
}
