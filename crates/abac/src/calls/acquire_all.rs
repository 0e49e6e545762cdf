//! `acquire_all`: several services at once, all or none.
//!
//! It is one transaction, so nobody ever holds some of them while it waits for others: there is no deadlock.

use crate::arguments::{Arguments, shown};
use crate::lifecycle::acquisition::Outcome;
use crate::lifecycle::{acquisition, confirmation, holders, lease_bounds};
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, store, target};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Grant};

/// Most services of one call.
const SERVICES_MAX: usize = 64;

/// `acquire_all OPTIONS_JSON SERVICE...`
pub(crate) fn acquire_all(ctx: &mut Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("acquire_all OPTIONS_JSON SERVICE...", args, 2, 1 + SERVICES_MAX)?;
    let principal = Principal::of(ctx.submitter()?);
    let wanted = "JSON with some of lease_ms and priority";
    let options: AcquireOptions = serde_json::from_str(args.text(0, "OPTIONS_JSON")?)
        .map_err(|fault| args.bad(0, "OPTIONS_JSON", fault.to_string(), wanted))?;
    if options.wait_ms.is_some() {
        return Err(args.bad(0, "OPTIONS_JSON", "wait_ms".to_owned(), wanted));
    }
    let mut targets: Vec<Target> = Vec::new();
    for index in 1..=args.rest(1).len() {
        let target = target::resolve(ctx, args.text(index, "SERVICE")?)?;
        if targets.iter().any(|known| known.id == target.id) {
            return Err(args.bad(index, "SERVICE", shown(&target.id), "each service once"));
        }
        if let Some(lease_ms) = options.lease_ms {
            lease_bounds::check_lease(&target, args, 0, lease_ms)?;
        }
        targets.push(target);
    }
    let mut grants: Vec<Grant> = Vec::new();
    for target in &targets {
        let granted = one(ctx, decider, target, &principal, &options).map_err(|mut refused| {
            refused.message = format!("none of {} is granted: {}", listed(&targets), refused.message);
            refused
        })?;
        grants.push(store::parse(b"grant", &granted)?);
    }
    store::json(&grants)
}

/// One of them, at once. If this one is refused, the transaction undoes all that were granted before it.
fn one(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: &Principal,
    options: &AcquireOptions,
) -> Result<Bytes, Rejection> {
    let (outcome, permit) = acquisition::may_acquire(ctx, decider, principal, target, options.priority)?;
    match outcome {
        Outcome::InLine { .. } => return Err(holders::held(target, &grant::live(ctx, &target.id)?)),
        Outcome::After { .. } => {
            if let Some(pending) = confirmation::first(ctx, decider, target, principal, options)? {
                return Err(Rejection::new(Code::Held, format!("{} must be confirmed first", principal.id()))
                    .found(format!("{} of {} confirmations", pending.confirmed.len(), pending.wanted))
                    .wanted("a confirmed contender")
                    .next(format!("acquire it alone first: ledgerctl acquire {}", target.id)));
            }
        }
        Outcome::Own(_) => {}
    }
    acquisition::enter(ctx, decider, target, principal.clone(), options, outcome, permit)
}

fn listed(targets: &[Target]) -> String {
    targets.iter().map(|target| target.id.as_str()).collect::<Vec<_>>().join(", ")
}
