//! `grants`: the live grants.

use crate::arguments::Arguments;
use crate::lifecycle::holders;
use crate::policy::decider::Decider;
use crate::records::grant::Holding;
use crate::records::{store, target};
use bytes::Bytes;
use ledger::{Context, Paging};
use ledger_base::rejection::Rejection;
use ledger_contract::Grant;

/// `grants [SERVICE|PAGE_JSON]`: the live grants of one service or of all.
pub(crate) fn list(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let of_one = args.first().is_some_and(|argument| !argument.starts_with(b"{"));
    let given = Arguments::new("grants [SERVICE|PAGE_JSON]", args, 0, 1)?;
    if of_one {
        let target = target::resolve(ctx, given.text(0, "SERVICE")?)?;
        return store::json(&holders::live(ctx, decider, &target)?);
    }
    let paging = Paging::of("grants", args)?;
    let read = |key: &[u8], value: &[u8]| shown(ctx, decider, store::parse(key, value)?);
    paging.answer(&paging.page(ctx, b"grant/", read)?)
}

/// A grant as it is listed, if it is live.
fn shown(ctx: &Context<'_>, decider: &Decider, holding: Holding) -> Result<Option<Grant>, Rejection> {
    if !holding.is_live(ctx.block_time()) {
        return Ok(None);
    }
    let mut grant = holding.grant;
    let target = target::resolve(ctx, &grant.service)?;
    grant.next_seq = holders::next_sequence(ctx, decider, &target, grant.epoch, &grant.holder)?;
    Ok(Some(grant))
}
