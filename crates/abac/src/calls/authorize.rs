//! `authorize`: would it be allowed now?

use crate::arguments::{Arguments, shown};
use crate::lifecycle::acquisition::Outcome;
use crate::lifecycle::{acquisition, holders, publishing, subscribing};
use crate::policy::action::Action;
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{grant, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::nearest::did_you_mean;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Answer of `authorize`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Authorization {
    /// May the caller do it now?
    pub allowed: bool,
    /// The stable code, e.g. `LGR-3001`; `LGR-0000` if allowed.
    pub code: String,
    /// The name of the code, e.g. `MISSING_ATTRIBUTE`.
    pub name: String,
    /// Why not, in words; empty if allowed.
    pub reason: String,
    /// The epoch of the caller's own grant; 0 if there is none.
    pub epoch: u64,
    /// The smallest sequence number that `set` accepts from the caller.
    pub next_seq: u64,
}

/// `authorize SERVICE [ACTION]`: would it be allowed now? Decided by the same code as `set` and `acquire`.
pub(crate) fn authorize(ctx: &Context<'_>, decider: &Decider, args: &[Bytes]) -> Result<Bytes, Rejection> {
    let args = Arguments::new("authorize SERVICE [acquire|publish|subscribe]", args, 1, 2)?;
    let target = decider.records.target(ctx, args.text(0, "SERVICE")?)?;
    let name = if args.has(1) { args.text(1, "ACTION")? } else { Action::Publish.name() };
    let action = Action::ALL.into_iter().find(|action| action.name() == name).ok_or_else(|| {
        let near = did_you_mean(name, Action::ALL.map(Action::name), "");
        args.bad(1, "ACTION", shown(name), "acquire, publish or subscribe").next(near)
    })?;
    let submitter = ctx.submitter()?;
    let principal = Principal::of(submitter);
    let outcome = match action {
        Action::Acquire => could_acquire(ctx, decider, &principal, &target),
        Action::Publish => publishing::may_publish(ctx, decider, submitter, &target, None).map(drop),
        Action::Subscribe => subscribing::may_subscribe(ctx, decider, submitter, &target),
        Action::Override | Action::Confirm => decider.decide(ctx, &principal, &target, action).map(drop),
    };
    let epoch = holders::own(ctx, &principal, &target).map_or(0, |own| own.grant.epoch);
    let code = outcome.as_ref().err().map_or(Code::Ok, |rejection| rejection.code);
    store::json(&Authorization {
        allowed: outcome.is_ok(),
        code: code.to_string(),
        name: code.name().to_owned(),
        reason: outcome.err().map(|rejection| rejection.message).unwrap_or_default(),
        epoch,
        next_seq: holders::next_sequence(ctx, decider, &target, epoch, &principal.id())?,
    })
}

/// Would they be granted it now, without waiting?
fn could_acquire(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<(), Rejection> {
    match acquisition::may_acquire(ctx, decider, principal, target, None)?.0 {
        Outcome::InLine { .. } => Err(holders::held(target, &grant::live(ctx, &target.id)?)),
        Outcome::Own(_) | Outcome::After { .. } => Ok(()),
    }
}
