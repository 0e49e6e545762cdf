//! Contenders that leave the queue, by themselves or not.

use super::settle::settle;
use crate::lifecycle::queue::TOLD_MAX;
use crate::lifecycle::{capacity, confirmation, queue, task_ends};
use crate::policy::decider::Decider;
use crate::records::line::Waiting;
use crate::records::target::Target;
use crate::records::{line, target};
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::LeftReason;

/// Most contenders that one look sends away, each with an event.
const LEAVING_MAX: usize = 256;

/// Takes a contender out of the queue, and ends its task with that.
pub(crate) fn dismiss(ctx: &mut Context<'_>, service: &str, place: &str, reason: LeftReason) -> Result<(), Rejection> {
    let follows = queue::drop_out(ctx, service, place, reason)?;
    settle(ctx, follows).map(drop)
}

/// Takes a contender out of the line, if it is there. Answers if it was.
pub(crate) fn leave(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    contender: &str,
    reason: LeftReason,
) -> Result<bool, Rejection> {
    if line::of(ctx, &target.id, contender)?.is_none() {
        return confirmation::withdraw(ctx, &target.id, contender, reason);
    }
    dismiss(ctx, &target.id, contender, reason)?;
    line::look_by(ctx, &target.id, ctx.block_time())?;
    queue::tell(ctx, decider, target)?;
    Ok(true)
}

/// A certificate was revoked: it waits nowhere any more.
pub(crate) fn revoked(
    ctx: &mut Context<'_>,
    decider: &Decider,
    issuer: &[u8; 32],
    serial: &[u8],
) -> Result<(), Rejection> {
    for (service, place) in line::of_certificate(ctx, issuer, serial) {
        dismiss(ctx, &service, &place, LeftReason::Revoked)?;
        line::look_by(ctx, &service, ctx.block_time())?;
        if let Ok(target) = target::resolve(ctx, &service) {
            queue::tell(ctx, decider, &target)?;
        }
    }
    confirmation::revoked(ctx, issuer, serial)?;
    task_ends::revoked(ctx, issuer, serial)
}

/// An organisation left: its members wait no more for this service. Events name the first of them.
pub(crate) fn members_left(
    ctx: &mut Context<'_>,
    decider: &Decider,
    target: &Target,
    organisation: &str,
) -> Result<(), Rejection> {
    let service = &target.id;
    confirmation::members_left(ctx, service, organisation)?;
    let waiting = line::all(ctx, service)?;
    task_ends::members_left(ctx, service, organisation)?;
    let theirs = waiting.iter().filter(|waiting| waiting.contender.split('/').next() == Some(organisation));
    if theirs.clone().next().is_none() {
        return Ok(());
    }
    for (waiting, told) in theirs.zip(0_usize..) {
        if told < TOLD_MAX {
            dismiss(ctx, service, &waiting.place(), LeftReason::Revoked)?;
        } else {
            line::remove(ctx, service, &waiting.place())?;
        }
    }
    line::look_by(ctx, service, ctx.block_time())?;
    queue::tell(ctx, decider, target)
}

/// Sends away who has waited as long as it wanted, and who the service has no room for any more.
pub(crate) fn send_away(ctx: &mut Context<'_>, decider: &Decider, target: &Target) -> Result<(), Rejection> {
    let (now, most) = (ctx.block_time(), decider.rules.of(target)?.line_max(&target.service.sharing));
    let mut beside = 0;
    let mut leaving = Vec::new();
    for waiting in line::all(ctx, &target.id)? {
        if waiting.until <= now {
            leaving.push((waiting, LeftReason::TimedOut));
        } else if beside >= most && !(most == 0 && waiting.task.is_some()) {
            leaving.push((waiting, LeftReason::Rule));
        } else {
            beside += 1;
        }
    }
    let leaving = leaving.iter().map(|(waiting, reason)| (waiting, *reason));
    if drop_some(ctx, &target.id, leaving)? { line::look_by(ctx, &target.id, now) } else { Ok(()) }
}

/// Takes contenders out of the line, as many as one look may. Answers if others are left.
pub(crate) fn drop_some<'w>(
    ctx: &mut Context<'_>,
    service: &str,
    leaving: impl Iterator<Item = (&'w Waiting, LeftReason)>,
) -> Result<bool, Rejection> {
    for ((waiting, reason), left) in leaving.zip(0..) {
        if left >= LEAVING_MAX || capacity::is_full(ctx) {
            return Ok(true);
        }
        dismiss(ctx, service, &waiting.place(), reason)?;
    }
    Ok(false)
}
