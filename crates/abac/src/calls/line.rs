//! `line`: the queue of a service.

use crate::arguments::Arguments;
use crate::lifecycle::confirmation;
use crate::lifecycle::contest::Contest;
use crate::policy::decider::Decider;
use crate::records::{pending, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::LineState;

/// `line SERVICE`: who holds a service, and who waits for it.
pub(crate) fn line(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("line SERVICE", args, 1, 1)?;
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let asking = pending::all(ctx, &target.id)?;
    let contest = Contest::of(ctx, &target)?;
    let wanted = target.service.sharing.confirm.unwrap_or(0);
    let pending = asking.iter().filter(|asking| asking.until > ctx.block_time());
    let pending = pending.map(|asking| confirmation::told(&target, asking, wanted)).collect();
    let line = contest.places(decider.rules.of(&target)?);
    let holders = contest.holders.into_iter().map(|holding| holding.grant).collect();
    store::json(&LineState { service: target.id.clone(), holders, line, pending })
}
