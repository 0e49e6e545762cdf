//! Tasks: the changes of one. A change returns what follows from it.

use super::follow_up::{Ending, FollowUp};
use crate::records::grant::Holding;
use crate::records::line::Waiting;
use crate::records::target::Target;
use crate::records::task::Kept;
use crate::records::{grant, line, store, task};
use crate::rules::terms::Terms;
use ledger::Context;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::Rejection;
use ledger_contract::{LeftReason, Reason, Task, TaskState, TaskTold};

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
fn finish(ctx: &mut Context<'_>, before: &Kept, state: TaskState, reason: &str) -> Result<Kept, Rejection> {
    let after = ended(ctx, before, state, reason)?;
    tell(ctx, &after)?;
    Ok(after)
}

pub(crate) fn ended(ctx: &mut Context<'_>, before: &Kept, state: TaskState, reason: &str) -> Result<Kept, Rejection> {
    let mut after = before.clone();
    after.task.state = state.into();
    after.task.reason = reason.to_owned();
    after.task.ended = Some(ctx.block_time());
    after.joins = None;
    task::replace(ctx, before, &after)?;
    Ok(after)
}

/// Ends an open task, and with it its place in the queue. Answers with the end of its grant.
pub(crate) fn conclude(
    ctx: &mut Context<'_>,
    before: &Kept,
    state: TaskState,
    reason: &str,
) -> Result<(Kept, Option<FollowUp>), Rejection> {
    let after = finish(ctx, before, state, reason)?;
    line::remove(ctx, &after.task.service, &after.place())?;
    let served = grant_of(ctx, before)?;
    Ok((after, served.map(|holding| Ending::of(&holding, Reason::TaskEnded))))
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
        Reason::Released => (TaskState::Cancelled, "its submitter released the service"),
        Reason::Delegated => (TaskState::Cancelled, "its submitter delegated the service"),
        Reason::Preempted => (TaskState::Preempted, "a contender with a higher priority preempted it"),
        Reason::Overridden => (TaskState::Preempted, "an emergency operator overrode it"),
        Reason::Stopped => (TaskState::Preempted, "the robot was stopped"),
        Reason::Expired => (TaskState::Failed, "its lease expired"),
        Reason::Revoked => (TaskState::Failed, REVOKED),
        Reason::Policy => (TaskState::Failed, POLICY),
        Reason::RobotRemoved => (TaskState::Failed, REMOVED),
        Reason::Idle => (TaskState::Failed, "its submitter published nothing within the idle limit of the service"),
        Reason::Taken => (TaskState::Failed, "the owner revoked the grant, or its rule has no slot for it"),
        _ => (TaskState::Failed, "its grant ended"),
    }
}

pub(crate) const REVOKED: &str = "its submitter's certificate was revoked, or its organisation was removed";

const POLICY: &str = "policies no longer permit it";

pub(crate) const REMOVED: &str = "the robot or the service was removed";

/// A task has lost its place in line, and got no grant.
pub(crate) fn left(ctx: &mut Context<'_>, id: u64, reason: LeftReason) -> Result<(), Rejection> {
    let waits = |kept: &Kept| kept.task.state == TaskState::Waiting;
    let Some(before) = task::find(ctx, id)?.filter(waits) else { return Ok(()) };
    let (state, why) = match reason {
        LeftReason::Left | LeftReason::Removed => (TaskState::Cancelled, "it was removed from the queue"),
        LeftReason::TimedOut => (TaskState::Expired, "its waiting time reached the limit of the service"),
        LeftReason::Policy => (TaskState::Failed, POLICY),
        LeftReason::Revoked => (TaskState::Failed, REVOKED),
        LeftReason::Expired => (TaskState::Failed, "its submitter's certificate has expired"),
        LeftReason::RobotRemoved => (TaskState::Failed, REMOVED),
        _ if before.task.started.is_some() => (TaskState::Preempted, "its slot was taken, and the queue is full"),
        _ => (TaskState::Failed, "others hold the service, and its queue is full"),
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

/// A task with its points.
pub(crate) fn whole(ctx: &Context<'_>, kept: Kept) -> Result<Task, Rejection> {
    let points = task::points(ctx, kept.task.id)?;
    Ok(Task { points, ..kept.task })
}
