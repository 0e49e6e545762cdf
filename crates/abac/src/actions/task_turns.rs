//! The way of a task by itself: it joins the line, runs, expires, and ends with its grant or with its place in line.

use super::end;
use crate::records::grant::{self, Holding};
use crate::records::line::{self, Waiting};
use crate::records::service::Target;
use crate::records::store;
use crate::records::task::{self, Kept};
use crate::rules::terms::Terms;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::Rejection;
use ledger_contract::{LeftReason, Reason, TaskState, TaskTold};

/// Most tasks of a service that join the line, expire or end with the service in one block.
const DUE_MAX: usize = 64;
/// Most tasks of an organisation that left of whose end one service tells.
const TOLD_MAX: usize = 16;

/// Tells how a task is now.
pub(crate) fn tell(ctx: &mut Context<'_>, kept: &Kept) -> Result<(), Rejection> {
    let task = kept.task.clone();
    let told = TaskTold {
        id: task.id,
        service: task.service,
        submitter: task.submitter,
        state: task.state,
        reached: task.reached,
        total: task.total,
        reason: task.reason,
    };
    ctx.emit("task", &told.service, store::json(&told)?);
    Ok(())
}

/// Ends a task whose grant and place in line somebody else ends.
pub(crate) fn finish(ctx: &mut Context<'_>, before: &Kept, state: TaskState, reason: &str) -> Result<Kept, Rejection> {
    let after = ended(ctx, before, state, reason)?;
    tell(ctx, &after)?;
    Ok(after)
}

fn ended(ctx: &mut Context<'_>, before: &Kept, state: TaskState, reason: &str) -> Result<Kept, Rejection> {
    let mut after = before.clone();
    after.task.state = state.into();
    after.task.reason = reason.to_owned();
    after.task.ended = Some(ctx.block_time());
    after.joins = None;
    task::replace(ctx, before, &after)?;
    Ok(after)
}

/// Ends an open task, and with it its grant or its place in line.
pub(crate) fn conclude(
    ctx: &mut Context<'_>,
    before: &Kept,
    state: TaskState,
    reason: &str,
) -> Result<Kept, Rejection> {
    let after = finish(ctx, before, state, reason)?;
    line::remove(ctx, &after.task.service, &after.place())?;
    if let Some(holding) = grant_of(ctx, before)? {
        end::end(ctx, &holding, Reason::TaskEnded)?;
    }
    Ok(after)
}

/// The live grant that serves a task.
pub(crate) fn grant_of(ctx: &Context<'_>, kept: &Kept) -> Result<Option<Holding>, Rejection> {
    let held = grant::held_by(ctx, &kept.task.service, &kept.task.submitter)?;
    Ok(held.filter(|holding| holding.grant.task == Some(kept.task.id)))
}

/// The turn of a task has come: its submitter holds the service for it.
pub(crate) fn runs(ctx: &mut Context<'_>, id: u64) -> Result<(), Rejection> {
    let Some(before) = task::find(ctx, id)? else { return Ok(()) };
    let mut after = before.clone();
    after.task.state = TaskState::Running.into();
    after.task.reason = String::new();
    after.task.started = Some(ctx.block_time());
    after.joins = None;
    task::replace(ctx, &before, &after)?;
    tell(ctx, &after)
}

/// A grant has ended: the task that it served ends with it, or waits again.
pub(crate) fn grant_ended(ctx: &mut Context<'_>, id: u64, reason: Reason) -> Result<(), Rejection> {
    let running = |kept: &Kept| kept.task.state == TaskState::Running;
    let Some(before) = task::find(ctx, id)?.filter(running) else { return Ok(()) };
    let (state, why) = outcome(reason);
    let requeue = before.task.requeue || active(Mutation::AlwaysWaitAgain);
    if state != TaskState::Preempted || !requeue {
        return finish(ctx, &before, state, why).map(drop);
    }
    let mut after = before.clone();
    after.task.state = TaskState::Waiting.into();
    after.task.reason = why.to_owned();
    after.joins = Some(ctx.block_time());
    task::replace(ctx, &before, &after)?;
    tell(ctx, &after)
}

/// How a task ends with its grant, and why.
fn outcome(reason: Reason) -> (TaskState, &'static str) {
    match reason {
        Reason::Released => (TaskState::Cancelled, "its submitter gave the service back"),
        Reason::Delegated => (TaskState::Cancelled, "its submitter passed the service on"),
        Reason::Preempted => (TaskState::Preempted, "a contender with a higher priority took its place"),
        Reason::Overridden => (TaskState::Preempted, "somebody took the service whatever its rule says"),
        Reason::Stopped => (TaskState::Preempted, "the robot was stopped"),
        Reason::Expired => (TaskState::Failed, "its lease ran out"),
        Reason::Revoked => (TaskState::Failed, REVOKED),
        Reason::Policy => (TaskState::Failed, POLICY),
        Reason::RobotRemoved => (TaskState::Failed, REMOVED),
        Reason::Idle => (TaskState::Failed, "its submitter published nothing for as long as the service allows"),
        Reason::Taken => (TaskState::Failed, "the owner took the service back, or its rule has no room for it"),
        _ => (TaskState::Failed, "its grant ended"),
    }
}

const REVOKED: &str = "its submitter's certificate was revoked, or its organisation left";
const POLICY: &str = "policies no longer permit it";
const REMOVED: &str = "the robot or the service was taken out of service";

/// A task has lost its place in line, and got no grant.
pub(crate) fn left(ctx: &mut Context<'_>, id: u64, reason: LeftReason) -> Result<(), Rejection> {
    let waits = |kept: &Kept| kept.task.state == TaskState::Waiting;
    let Some(before) = task::find(ctx, id)?.filter(waits) else { return Ok(()) };
    let (state, why) = match reason {
        LeftReason::Left | LeftReason::Removed => (TaskState::Cancelled, "it was taken out of the line"),
        LeftReason::TimedOut => (TaskState::Expired, "it waited as long as the service allows"),
        LeftReason::Policy => (TaskState::Failed, POLICY),
        LeftReason::Revoked => (TaskState::Failed, REVOKED),
        LeftReason::Expired => (TaskState::Failed, "its submitter's certificate has run out"),
        LeftReason::RobotRemoved => (TaskState::Failed, REMOVED),
        _ if before.task.started.is_some() => (TaskState::Preempted, "its place was taken, and the line has no room"),
        _ => (TaskState::Failed, "others hold the service, and its line has no room"),
    };
    finish(ctx, &before, state, why).map(drop)
}

/// Puts a task in line.
pub(crate) fn join(ctx: &mut Context<'_>, target: &Target, kept: &Kept) -> Result<(), Rejection> {
    let now = ctx.block_time();
    let wait = Terms::of(&target.service.sharing).queue_wait_max_us;
    let waiting = Waiting {
        contender: kept.task.submitter.clone(),
        ticket: line::all(ctx, &target.id)?.last().map_or(1, |last| last.ticket + 1),
        priority: kept.task.priority,
        since: now,
        until: now.saturating_add(wait).min(kept.principal.not_after),
        lease_ms: kept.lease_ms,
        task: Some(kept.task.id),
    };
    line::put(ctx, &target.id, &waiting, &kept.principal)?;
    line::look_by(ctx, &target.id, waiting.until)
}

/// Tasks whose time has come join the line; those whose deadline has passed expire.
pub(crate) fn due(ctx: &mut Context<'_>, target: &Target) -> Result<(), Rejection> {
    let now = ctx.block_time();
    for (_, id) in task::next(ctx, &target.id, DUE_MAX).into_iter().filter(|(time, _)| *time <= now) {
        if end::is_full(ctx) {
            break;
        }
        let Some(before) = task::find(ctx, id)? else { continue };
        if before.task.deadline.is_some_and(|deadline| deadline <= now) {
            conclude(ctx, &before, TaskState::Expired, "its deadline passed")?;
            continue;
        }
        if target.service.sharing.confirm.is_some() {
            conclude(
                ctx,
                &before,
                TaskState::Failed,
                "the service takes no tasks now: others must confirm who uses it",
            )?;
            continue;
        }
        let mut after = before.clone();
        after.joins = None;
        after.task.state = TaskState::Waiting.into();
        join(ctx, target, &after)?;
        task::replace(ctx, &before, &after)?;
        if after.task.state != before.task.state {
            tell(ctx, &after)?;
        }
    }
    Ok(())
}

/// When a task of a service joins the line or expires next (block time, microseconds).
pub(crate) fn next_due(ctx: &Context<'_>, service: &str) -> Option<u64> {
    task::next(ctx, service, 1).first().map(|(time, _)| *time)
}

/// The service is gone: its tasks have failed. Those that run end with their grants.
pub(crate) fn dissolve(ctx: &mut Context<'_>, service: &str) -> Result<(), Rejection> {
    for id in task::open(ctx, service, DUE_MAX) {
        if end::is_full(ctx) {
            break;
        }
        if let Some(before) = task::find(ctx, id)? {
            conclude(ctx, &before, TaskState::Failed, REMOVED)?;
        }
    }
    let is_done = task::open(ctx, service, 1).is_empty();
    if is_done { Ok(()) } else { line::look_by(ctx, service, ctx.block_time()) }
}

/// A certificate was revoked: its tasks have failed. Those that run have ended with their grants.
pub(crate) fn revoked(ctx: &mut Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Result<(), Rejection> {
    for id in task::of_certificate(ctx, issuer, serial) {
        if let Some(before) = task::find(ctx, id)?.filter(|kept| kept.task.state != TaskState::Running) {
            conclude(ctx, &before, TaskState::Failed, REVOKED)?;
        }
    }
    Ok(())
}

/// An organisation left: its members' tasks for this service have failed. Events name the first of them. Those that run
/// end with their grants.
pub(crate) fn members_left(ctx: &mut Context<'_>, service: &str, organisation: &str) -> Result<(), Rejection> {
    let mut told = 0;
    for id in task::open(ctx, service, usize::MAX) {
        let theirs = |kept: &Kept| kept.principal.organisation == organisation && kept.task.state != TaskState::Running;
        let Some(before) = task::find(ctx, id)?.filter(theirs) else { continue };
        line::remove(ctx, service, &before.place())?;
        let after = ended(ctx, &before, TaskState::Failed, REVOKED)?;
        told += 1;
        if told <= TOLD_MAX {
            tell(ctx, &after)?;
        }
    }
    Ok(())
}
