//! `take`: a service whatever its rule says.

use crate::arguments::Arguments;
use crate::lifecycle::acquisition;
use crate::lifecycle::contest::OVERRIDING;
use crate::lifecycle::follow_up::Ending;
use crate::lifecycle::grants::{GrantTerms, Inheritance};
use crate::lifecycle::settle::settle;
use crate::lifecycle::{lease_bounds, queue, stops};
use crate::policy::decider;
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::{grant, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::Reason;

/// `take SERVICE REASON [LEASE_MS]`: the service, whatever its rule says; by an admin of the owner, or whom policies permit
/// `override`.
pub(crate) fn take(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("take SERVICE REASON [LEASE_MS]", args, 2, 3)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let reason = args.text(1, "REASON")?.to_owned();
    let lease_ms = if args.has(2) { lease_bounds::lease(&target, args, 2)? } else { target.service.lease_ms };
    let permit = decider::may_override(ctx, decider, &principal, &target)?;
    stops::check_goes(ctx, &target)?;
    let held = grant::live(ctx, &target.id)?;
    settle(ctx, held.iter().map(|holding| Ending::for_other(holding, Reason::Overridden, &principal)))?;
    queue::granted(ctx, decider, &target, &principal.id())?;
    let (taken, inherited) = (Some(reason), Inheritance::default());
    let terms = GrantTerms { principal, lease_ms, priority: OVERRIDING, permit, taken, inherited, task: None };
    acquisition::give(ctx, decider, &target, terms)
}
