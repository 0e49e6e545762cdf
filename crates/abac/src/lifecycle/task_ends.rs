//! Tasks that join the queue, expire, or fail without a call.

use super::settle::settle;
use crate::lifecycle::tasks::{REMOVED, REVOKED};
use crate::lifecycle::{capacity, tasks};
use crate::records::target::Target;
use crate::records::task::Kept;
use crate::records::{line, task};
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::TaskState;

/// Most tasks of a service that join the line, expire or end with the service in one block.
const DUE_MAX: usize = 64;

/// Most tasks of an organisation that left of whose end one service tells.
const TOLD_MAX: usize = 16;

/// Ends an open task, and with it its grant or its place in the queue.
pub(crate) fn conclude(
    ctx: &mut Context<'_>,
    before: &Kept,
    state: TaskState,
    reason: &str,
) -> Result<Kept, Rejection> {
    let (after, served) = tasks::conclude(ctx, before, state, reason)?;
    settle(ctx, served)?;
    Ok(after)
}

/// Tasks whose time has come join the line; those whose deadline has passed expire.
pub(crate) fn due(ctx: &mut Context<'_>, target: &Target) -> Result<(), Rejection> {
    let now = ctx.block_time();
    for (_, id) in task::next(ctx, &target.id, DUE_MAX).into_iter().filter(|(time, _)| *time <= now) {
        if capacity::is_full(ctx) {
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
                "the service no longer accepts tasks: it requires confirmations",
            )?;
            continue;
        }
        let mut after = before.clone();
        after.joins = None;
        after.task.state = TaskState::Waiting.into();
        tasks::join(ctx, target, &after)?;
        task::replace(ctx, &before, &after)?;
        if after.task.state != before.task.state {
            tasks::tell(ctx, &after)?;
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
        if capacity::is_full(ctx) {
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
        let after = tasks::ended(ctx, &before, TaskState::Failed, REVOKED)?;
        told += 1;
        if told <= TOLD_MAX {
            tasks::tell(ctx, &after)?;
        }
    }
    Ok(())
}
