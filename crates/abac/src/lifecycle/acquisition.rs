//! How a contender gets a grant: what the policies and the rule of the service decide, and what becomes of it.

use super::follow_up::Ending;
use super::grants::{GrantTerms, Inheritance};
use super::settle::settle;
use crate::lifecycle::contest::Contest;
use crate::lifecycle::{contest, grants, holders, queue, stops};
use crate::policy::decider::Decider;
use crate::policy::{Permit, decider};
use crate::records::grant::{HOLDERS_MAX, Holding};
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, line, store};
use crate::rules::Decision;
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Acquired, Reason};

/// The position of a contender that has no grant.
pub(crate) enum Outcome {
    /// The contender has a grant already.
    Own(Box<Holding>),
    /// These grants, which end for it.
    After { ended: Vec<Holding>, priority: i64 },
    /// The line, until that time at least (block time, microseconds).
    InLine { again: Option<u64>, priority: i64 },
}

/// Gives one who may the room that there is for it: a grant, or a place in line.
pub(crate) fn enter(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: Principal,
    options: &AcquireOptions,
    outcome: Outcome,
    permit: Permit,
) -> Result<Bytes, Rejection> {
    let (ending, priority, inherited) = match outcome {
        Outcome::Own(own) if own.principal.same_certificate(&principal) => {
            return grants::renewed(ctx, decider, target, *own, &permit, options.lease_ms);
        }
        // Another certificate of the same person: whoever holds the old one must be fenced off.
        Outcome::Own(own) => (vec![(own.as_ref().clone(), Reason::Released)], own.priority, Inheritance::on(&own)),
        Outcome::After { ended, priority } => {
            (ended.into_iter().map(|holding| (holding, Reason::Preempted)).collect(), priority, Inheritance::default())
        }
        Outcome::InLine { again, priority } => {
            let queued = queue::join(ctx, decider, target, &principal, options, priority)?;
            if let Some(again) = again {
                line::look_by(ctx, &target.id, again)?;
            }
            return store::json(&Acquired::Queued { queued });
        }
    };
    let preempts = ending.iter().any(|(_, reason)| *reason == Reason::Preempted);
    let ending: Vec<_> =
        ending.iter().map(|(holding, reason)| Ending::for_other(holding, *reason, &principal)).collect();
    settle(ctx, ending)?;
    queue::granted(ctx, decider, target, &principal.id())?;
    let lease_ms = options.lease_ms.unwrap_or(target.service.lease_ms);
    let inherited = Inheritance { preempts, ..inherited };
    give(ctx, decider, target, GrantTerms { principal, lease_ms, priority, permit, taken: None, inherited, task: None })
}

/// Gives a grant to one for whom there is room.
pub(crate) fn give(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    terms: GrantTerms,
) -> Result<Bytes, Rejection> {
    let expired = grants::expired(ctx, &target.id)?;
    settle(ctx, expired)?;
    let (granted, follows) = grants::create(ctx, decider, target, terms)?;
    settle(ctx, follows)?;
    Ok(granted)
}

/// Algorithm 1 of the paper: may this principal have a grant now, by the policies and beside those who hold one?
///
/// # Errors
/// The answer of the policies, [`Code::Stopped`], [`Code::Held`], or [`Code::LimitExceeded`].
pub(crate) fn may_acquire(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
    asked: Option<i64>,
) -> Result<(Outcome, Permit), Rejection> {
    let own = grant::held_by(ctx, &target.id, &principal.id())?;
    let givers = own.iter().flat_map(|own| &own.givers).map(|giver| &giver.principal);
    let permit = decider::may_hold_after(ctx, decider, givers, principal, target)?;
    stops::check_goes(ctx, target)?;
    if let Some(own) = own {
        return Ok((Outcome::Own(Box::new(own)), permit));
    }
    let priority = contest::priority(target, principal, &permit, asked)?;
    let contest = Contest::of(ctx, target)?;
    let waits = contest.line.iter().find(|waiting| waiting.place() == principal.id());
    let contender = match waits {
        Some(waiting) => contest::claim(waiting),
        None => contest::newcomer(ctx, principal.id(), priority),
    };
    let outcome = outcome(target, &contest, contest.decide(decider.rules.of(target)?, &contender), priority)?;
    Ok((outcome, permit))
}

/// The position of a contender that holds nothing of the service, as the rule has decided.
///
/// # Errors
/// [`Code::Held`], or [`Code::LimitExceeded`].
pub(crate) fn outcome(
    target: &Target,
    contest: &Contest<'_>,
    decision: Decision,
    priority: i64,
) -> Result<Outcome, Rejection> {
    match decision {
        Decision::Refuse => Err(holders::held(target, &contest.holders)),
        Decision::Wait { again } => Ok(Outcome::InLine { again, priority }),
        Decision::Grant { ends } => {
            let ended: Vec<Holding> = ends.iter().filter_map(|index| contest.holders.get(*index)).cloned().collect();
            match contest.holders.len() - ended.len() {
                beside if beside >= HOLDERS_MAX => Err(full(target, beside)),
                _ => Ok(Outcome::After { ended, priority }),
            }
        }
    }
}

fn full(target: &Target, holders: usize) -> Rejection {
    Rejection::new(Code::LimitExceeded, format!("{} has reached its limit of holders", target.id))
        .found(format!("{holders} holders"))
        .wanted(format!("at most {HOLDERS_MAX}"))
}
