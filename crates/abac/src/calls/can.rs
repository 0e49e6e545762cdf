//! `can`: may somebody do something, and why?

use crate::arguments::Arguments;
use crate::calls::question;
use crate::calls::question::Case;
use crate::lifecycle::people;
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `can ASK_JSON`: may this person do that, and why?
pub(crate) fn can(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("can ASK_JSON", args, 1, 1)?;
    let ask = question::read(args)?;
    let caller = Principal::of(ctx.submitter()?);
    let principal = match &ask.who {
        Some(who) if *who != caller.id() => people::certified(ctx, who)?,
        _ => caller,
    };
    let case = Case::of(ctx, decider, &ask)?;
    store::json(&case.judge(ctx, decider, &principal)?)
}
