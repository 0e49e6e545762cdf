//! `renew`: a longer lease.

use crate::arguments::Arguments;
use crate::lifecycle::lease_bounds::lease;
use crate::lifecycle::{grants, holders};
use crate::policy::decider;
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::target;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `renew SERVICE [LEASE_MS]`
pub(crate) fn renew(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("renew SERVICE [LEASE_MS]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let own = holders::own(ctx, &principal, &target)?;
    let permit = decider::may_keep(ctx, decider, &own, &target)?;
    let lease_ms = if args.has(1) { Some(lease(&target, args, 1)?) } else { None };
    grants::renewed(ctx, decider, &target, own, &permit, lease_ms)
}
