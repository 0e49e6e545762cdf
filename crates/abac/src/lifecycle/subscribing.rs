//! The right to read the messages of a service.

use crate::lifecycle::holders;
use crate::policy::action::Action;
use crate::policy::decider::Decider;
use crate::records::principal::Principal;
use crate::records::target::Target;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::Rejection;
use ledger_contract::readers;
use ledger_identity::{Identity, Role};

/// May they read the messages of a service? Policies decide. Where the owner limits the subscribers, everybody but its own
/// robots and nodes needs a place, too: `k2` of the paper.
///
/// # Errors
/// Those of [`Decider::decide`]; [`ledger_base::rejection::Code::NotHolder`] without a place.
pub(crate) fn may_subscribe(
    ctx: &Context<'_>,
    decider: &Decider,
    submitter: &Identity,
    target: &Target,
) -> Result<(), Rejection> {
    let principal = Principal::of(submitter);
    decider.decide(ctx, &principal, target, Action::Subscribe)?;
    if !needs_place(&principal, target)
        || active(Mutation::ReadWithoutAPlace)
        || decider.records.held(ctx, &readers(target.service_id()), submitter)?.is_some()
    {
        return Ok(());
    }
    has_place(ctx, &principal, target)
}

/// As [`may_subscribe`], of one who does not ask now. Answers when the window of the policies closes (block time, microseconds).
pub(crate) fn may_be_sent(
    ctx: &Context<'_>,
    decider: &Decider,
    principal: &Principal,
    target: &Target,
) -> Result<Option<u64>, Rejection> {
    let permit = decider.decide(ctx, principal, target, Action::Subscribe)?;
    if needs_place(principal, target) {
        has_place(ctx, principal, target)?;
    }
    Ok(permit.closes)
}

/// Do they need a place to read? Robots and nodes of the owner never do.
fn needs_place(principal: &Principal, target: &Target) -> bool {
    let carries = matches!(principal.role, Role::Robot | Role::Node);
    let is_owners = principal.organisation == target.robot.organisation;
    target.service.sharing.subscribers.is_some() && !(carries && is_owners)
}

/// Do they have the place that they need?
fn has_place(ctx: &Context<'_>, principal: &Principal, target: &Target) -> Result<(), Rejection> {
    let places = Target::of_readers(&target.robot, &target.service);
    places.map_or(Ok(()), |places| holders::own(ctx, principal, &places).map(drop))
}
