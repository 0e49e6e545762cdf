//! `acquire`: a grant, a place in the queue, or a request to be confirmed.

use crate::arguments::Arguments;
use crate::lifecycle::acquisition::Outcome;
use crate::lifecycle::{acquisition, confirmation, lease_bounds};
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::{AcquireOptions, Acquired};

const USAGE: &str = "acquire SERVICE [LEASE_MS|OPTIONS_JSON]";

/// `acquire SERVICE [LEASE_MS|OPTIONS_JSON]`
pub(crate) fn acquire(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new(USAGE, args, 1, 2)?;
    let principal = Principal::of(ctx.submitter()?);
    let target = target::resolve(ctx, args.text(0, "SERVICE")?)?;
    let options = options(&target, args)?;
    let (outcome, permit) = acquisition::may_acquire(ctx, decider, &principal, &target, options.priority)?;
    let waits = match &outcome {
        Outcome::Own(_) => false,
        Outcome::InLine { .. } => options.wait_ms != Some(0),
        Outcome::After { .. } => true,
    };
    if waits && let Some(pending) = confirmation::first(ctx, decider, &target, &principal, &options)? {
        return store::json(&Acquired::Pending { pending });
    }
    acquisition::enter(ctx, decider, &target, principal, &options, outcome, permit)
}

/// The wishes of the caller besides the service.
fn options(target: &Target, args: Arguments<'_>) -> Result<AcquireOptions, Rejection> {
    if !args.has(1) {
        return Ok(AcquireOptions::default());
    }
    let text = args.text(1, "LEASE_MS|OPTIONS_JSON")?;
    if !text.starts_with('{') {
        return Ok(AcquireOptions {
            lease_ms: Some(lease_bounds::lease(target, args, 1)?),
            ..AcquireOptions::default()
        });
    }
    let options: AcquireOptions = serde_json::from_str(text).map_err(|fault| {
        args.bad(1, "OPTIONS_JSON", fault.to_string(), "JSON with some of lease_ms, wait_ms and priority")
    })?;
    if let Some(lease_ms) = options.lease_ms {
        lease_bounds::check_lease(target, args, 1, lease_ms)?;
    }
    Ok(options)
}
