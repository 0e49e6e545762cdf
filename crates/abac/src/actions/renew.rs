//! `renew`, and how the use of a grant renews it.

use super::acquire::lease;
use super::{hold, publish};
use crate::arguments::Arguments;
use crate::policy::decider::{self, Decider};
use crate::policy::{Permit, texts};
use crate::records::grant::{self, Holding};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use crate::records::store;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;

/// `renew SERVICE [LEASE_MS]`
pub(crate) fn renew(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("renew SERVICE [LEASE_MS]", args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = service::resolve(ctx, args.text(0, "SERVICE")?)?;
    let own = hold::own(ctx, &principal, &target)?;
    let permit = decider::may_keep(ctx, decider, &own, &target)?;
    let lease_ms = if args.has(1) { Some(lease(&target, args, 1)?) } else { None };
    renewed(ctx, decider, &target, own, &permit, lease_ms)
}

/// Renews a grant and tells so.
pub(crate) fn renewed(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    before: Holding,
    permit: &Permit,
    lease_ms: Option<u64>,
) -> Result<Bytes, Rejection> {
    let mut after = before.clone();
    after.grant.lease_ms = lease_ms.unwrap_or(before.grant.lease_ms).min(target.service.lease_ms_max);
    after.grant.next_seq = publish::next_sequence(ctx, decider, target, before.grant.epoch, &before.grant.holder)?;
    after.bind(&target.service, &permit.limits, permit.closes);
    after.decided_by(texts::version(ctx, &target.robot.organisation)?.number, &permit.policies);
    after.extend(ctx.block_time());
    grant::replace(ctx, &before, &after)?;
    let told = store::json(&after.grant)?;
    ctx.emit("renewed", &target.id, told.clone());
    Ok(told)
}

/// Renews a grant because it is used. It writes only when more than a quarter of the lease is used up. It asks only
/// policies that look at the time; all others ended the grant when they changed.
pub(crate) fn used(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    before: &Holding,
) -> Result<(), Rejection> {
    let now = ctx.block_time();
    let quarter = before.grant.lease_ms.saturating_mul(250);
    if before.extended(now).saturating_sub(before.grant.expires) <= quarter {
        return Ok(());
    }
    let Ok(permit) = decider::may_keep(ctx, decider, before, target) else { return Ok(()) };
    let mut after = before.clone();
    after.bind(&target.service, &permit.limits, permit.closes);
    after.decided_by(texts::version(ctx, &target.robot.organisation)?.number, &permit.policies);
    after.extend(now);
    grant::replace(ctx, before, &after)
}
