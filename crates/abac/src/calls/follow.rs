//! The right to see events.

use crate::arguments::shown;
use crate::calls::set::MESSAGE;
use crate::lifecycle::subscribing;
use crate::policy::decider::Decider;
use crate::records::target;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::result::Event;

/// May the submitter see this event? Messages need the right to subscribe. Every member of the network may see
/// all other events.
pub(crate) fn may_read(ctx: &Context<'_>, decider: &Decider, event: &Event) -> Result<(), Rejection> {
    let submitter = ctx.submitter()?;
    if event.name != MESSAGE {
        return Ok(());
    }
    let target = decider.records.target(ctx, &event.subject)?;
    subscribing::may_subscribe(ctx, decider, submitter, &target)
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
    for subject in subjects.iter().filter(|subject| messages_only || !target::split(subject).1.is_empty()) {
        match decider.records.target(ctx, subject) {
            Ok(target) if target.id == *subject => {
                subscribing::may_subscribe(ctx, decider, submitter, &target)?;
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
