//! The right to see events.

use super::hold;
use super::publish::MESSAGE;
use crate::arguments::shown;
use crate::policy::decider::{Action, Decider};
use crate::records::principal::Principal;
use crate::records::service::{self, Target};
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::readers;
use ledger_identity::{Identity, Role};
use ledger_storage::result::Event;

/// May the submitter see this event? Messages need the right to subscribe. Every member of the network may see
/// all other events.
pub(crate) fn may_read(ctx: &Context<'_>, decider: &Decider, event: &Event) -> Result<(), Rejection> {
    let submitter = ctx.submitter()?;
    if event.name != MESSAGE {
        return Ok(());
    }
    let target = decider.records.target(ctx, &event.subject)?;
    may_subscribe(ctx, decider, submitter, &target)
}

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
    places.map_or(Ok(()), |places| hold::own(ctx, principal, &places).map(drop))
}

/// May the submitter follow these events? A reader of messages of services needs the right to subscribe to each.
///
/// A service that does not exist is refused, unless the events of its robot are asked for as well: they tell when it comes.
pub(crate) fn may_follow(
    ctx: &Context<'_>,
    decider: &Decider,
    subjects: &[String],
    names: &[String],
) -> Result<(), Rejection> {
    if !names.iter().any(|name| name == MESSAGE) {
        return Ok(());
    }
    let submitter = ctx.submitter()?;
    let (messages_only, waits) = (names.len() == 1, names.iter().any(|name| name == "robot"));
    for subject in subjects.iter().filter(|subject| messages_only || !service::split(subject).1.is_empty()) {
        match decider.records.target(ctx, subject) {
            Ok(target) if target.id == *subject => {
                may_subscribe(ctx, decider, submitter, &target)?;
            }
            Ok(target) => {
                return Err(Rejection::new(
                    Code::UnknownService,
                    format!("{subject} is a robot and sends no messages"),
                )
                .found(shown(subject))
                .wanted(format!("a service, {}", target.id))
                .next(format!("subscribe to {}", target.id)));
            }
            Err(unknown) if waits && matches!(unknown.code, Code::UnknownRobot | Code::UnknownService) => {}
            Err(unknown) => return Err(unknown),
        }
    }
    Ok(())
}
