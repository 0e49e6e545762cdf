//! `robot`: one robot.

use crate::arguments::Arguments;
use crate::calls::views;
use crate::policy::decider::Decider;
use crate::records::{robot, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `robot NAME`
pub(crate) fn robot(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("robot NAME", args, 1, 1)?;
    store::json(&views::asset(ctx, decider, &robot::find(ctx, args.text(0, "NAME")?)?)?)
}
