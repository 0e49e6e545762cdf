//! The queue of a service: joining it, and losing a place in it.

use super::follow_up::FollowUp;
use crate::lifecycle::contest::Contest;
use crate::lifecycle::holders;
use crate::policy::decider::Decider;
use crate::records::line::Waiting;
use crate::records::principal::Principal;
use crate::records::target::Target;
use crate::records::{line, pending, store};
use crate::rules::terms::Terms;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{AcquireOptions, Left, LeftReason, LineTold, Place};

/// Most lines in which one certificate waits.
pub(crate) const WAITS_MAX: usize = 64;

/// How many of a line an event names.
pub(crate) const TOLD_MAX: usize = 16;

/// Puts a contender in line, or tells it the place that it has.
///
/// # Errors
/// [`Code::Held`] if it does not want to wait, [`Code::LineFull`], or [`Code::LimitExceeded`].
pub(crate) fn join(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    principal: &Principal,
    options: &AcquireOptions,
    priority: i64,
) -> Result<Place, Rejection> {
    let contest = Contest::of(ctx, target)?;
    let terms = Terms::of(&target.service.sharing);
    if options.wait_ms == Some(0) {
        return Err(holders::held(target, &contest.holders));
    }
    let contender = principal.id();
    let before = contest.line.iter().find(|waiting| waiting.place() == contender);
    if before.is_none() {
        let most = decider.rules.of(target)?.line_max(&target.service.sharing);
        check_room(ctx, target, principal, &contest, most)?;
    }
    let now = ctx.block_time();
    let wait =
        options.wait_ms.map_or(terms.queue_wait_max_us, |ms| ms.saturating_mul(1000).min(terms.queue_wait_max_us));
    let waiting = Waiting {
        contender: contender.clone(),
        ticket: before.map_or_else(|| contest.line.last().map_or(1, |last| last.ticket + 1), |before| before.ticket),
        priority: before.map_or(priority, |before| before.priority),
        since: before.map_or(now, |before| before.since),
        until: now.saturating_add(wait).min(principal.not_after),
        lease_ms: options.lease_ms.or(before.and_then(|before| before.lease_ms)),
        task: None,
    };
    let is_new = before.is_none();
    pending::remove(ctx, &target.id, &contender)?;
    line::put(ctx, &target.id, &waiting, principal)?;
    line::look_by(ctx, &target.id, waiting.until)?;
    let places = Contest::of(ctx, target)?.places(decider.rules.of(target)?);
    let place = places.iter().find(|place| place.contender == contender && place.task.is_none()).cloned();
    let place = place.ok_or_else(|| Rejection::new(Code::Internal, format!("{contender} is not in the queue")))?;
    ctx.emit("queued", &target.id, store::json(&place)?);
    if is_new {
        tell_places(ctx, target, &places)?;
    }
    Ok(place)
}

/// Refuses one more place in a line that is full, or to a certificate that has too many.
pub(crate) fn check_room(
    ctx: &Context<'_>,
    target: &Target,
    principal: &Principal,
    contest: &Contest<'_>,
    most: u64,
) -> Result<(), Rejection> {
    let id = &target.id;
    if contest.line.len() as u64 >= most {
        return Err(Rejection::new(Code::LineFull, format!("the queue for {id} is full"))
            .found(format!("{} contenders", contest.line.len()))
            .wanted(format!("fewer than {most}"))
            .next(format!("try again later; to see the queue: ledgerctl queue {id}")));
    }
    let serial = hex::decode(&principal.serial).unwrap_or_default();
    let waits = line::of_certificate(ctx, &principal.issuer.0, &serial).len();
    if waits >= WAITS_MAX {
        return Err(Rejection::new(Code::LimitExceeded, format!("{} waits in too many queues", principal.id()))
            .found(format!("{waits} queues"))
            .wanted(format!("fewer than {WAITS_MAX}"))
            .next("leave a queue first: ledgerctl release ROBOT/TOPIC"));
    }
    Ok(())
}

/// A contender is given the service now: it waits no longer.
pub(crate) fn granted(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    contender: &str,
) -> Result<(), Rejection> {
    pending::remove(ctx, &target.id, contender)?;
    if line::of(ctx, &target.id, contender)?.is_some() {
        line::remove(ctx, &target.id, contender)?;
        tell(ctx, decider, target)?;
    }
    Ok(())
}

/// Takes a contender out of the queue. Answers with what follows.
pub(crate) fn drop_out(
    ctx: &mut Context<'_>,
    service: &str,
    place: &str,
    reason: LeftReason,
) -> Result<Option<FollowUp>, Rejection> {
    line::remove(ctx, service, place)?;
    if let Some(id) = line::task_at(place) {
        return Ok(Some(FollowUp::TaskLeftQueue { id, reason }));
    }
    let left = Left { service: service.to_owned(), contender: place.to_owned(), reason: reason.into() };
    ctx.emit("left", service, store::json(&left)?);
    Ok(None)
}

/// Tells how the line is now.
pub(crate) fn tell(ctx: &mut Context<'_>, decider: &Decider, target: &Target) -> Result<(), Rejection> {
    let places = Contest::of(ctx, target)?.places(decider.rules.of(target)?);
    tell_places(ctx, target, &places)
}

fn tell_places(ctx: &mut Context<'_>, target: &Target, places: &[Place]) -> Result<(), Rejection> {
    let next = places.iter().take(TOLD_MAX).map(|place| place.contender.clone()).collect();
    let told = LineTold { service: target.id.clone(), waiting: places.len() as u64, next };
    ctx.emit("line", &target.id, store::json(&told)?);
    Ok(())
}
