//! Tasks: what a user wants of a robot, and how far it is.
//!
//! A task without its points is one key, its points are another one that never changes: so progress is quick to write. More
//! keys find the open tasks of a service and of a certificate, and order those that have ended. They are written and
//! removed together, and only here.

use super::principal::Principal;
use super::{line, store};
use bytes::Bytes;
use ledger::Context;
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::{Point, Task};
use serde::{Deserialize, Serialize};

/// How many tasks of a service that have ended are kept.
const ENDED_KEPT: usize = 16;

/// A task as the state holds it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Kept {
    /// Without its points.
    pub(crate) task: Task,
    /// Its submitter.
    pub(crate) principal: Principal,
    /// When it joins the line (block time, microseconds), if it is not there yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) joins: Option<u64>,
    /// The lease that it asked for, milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) lease_ms: Option<u64>,
}

impl Kept {
    /// The name of its place in line.
    pub(crate) fn place(&self) -> String {
        line::place_of(&self.task.submitter, self.task.id)
    }

    fn is_open(&self) -> bool {
        self.task.ended.is_none()
    }

    /// When it joins the line or expires (block time, microseconds), whatever comes first.
    fn time(&self) -> Option<u64> {
        [self.joins, self.task.deadline].into_iter().flatten().min()
    }

    fn submitted_prefix(&self) -> Vec<u8> {
        submitted_prefix(&self.principal)
    }
}

fn submitted_prefix(principal: &Principal) -> Vec<u8> {
    store::submitted_prefix(&principal.issuer.0, &hex::decode(&principal.serial).unwrap_or_default())
}

/// The number of the next task, which is used up by this.
pub(crate) fn next_id(ctx: &mut Context<'_>) -> Result<u64, Rejection> {
    let newest: u64 = store::read(ctx, store::TASKS)?.unwrap_or(0);
    let id = newest
        .checked_add(1)
        .ok_or_else(|| Rejection::new(Code::LimitExceeded, "the numbers of tasks are exhausted"))?;
    store::write(ctx, store::TASKS, &id)?;
    Ok(id)
}

/// Writes a new task with its points.
pub(crate) fn add(ctx: &mut Context<'_>, kept: &Kept, points: &[Point]) -> Result<(), Rejection> {
    let Task { id, service, .. } = &kept.task;
    store::write(ctx, &store::points_key(*id), &points)?;
    ctx.put(&store::with_task(store::open_prefix(service), *id), Bytes::new());
    ctx.put(&store::with_task(kept.submitted_prefix(), *id), Bytes::new());
    write(ctx, kept)
}

/// Writes a task and when it is due.
fn write(ctx: &mut Context<'_>, kept: &Kept) -> Result<(), Rejection> {
    let Task { id, service, .. } = &kept.task;
    if let Some(time) = kept.time().filter(|_| kept.is_open()) {
        ctx.put(&store::with_time(store::times_prefix(service), time, *id), Bytes::new());
        line::look_by(ctx, service, time)?;
    }
    store::write(ctx, &store::task_key(*id), kept)
}

/// Puts a task in the place of what it was. One that has ended is open no more, and the oldest of those is forgotten.
pub(crate) fn replace(ctx: &mut Context<'_>, before: &Kept, after: &Kept) -> Result<(), Rejection> {
    let Task { id, service, .. } = &after.task;
    if let Some(time) = before.time() {
        ctx.delete(&store::with_time(store::times_prefix(service), time, *id));
    }
    write(ctx, after)?;
    let Some(ended) = after.task.ended else { return Ok(()) };
    ctx.delete(&store::with_task(store::open_prefix(service), *id));
    ctx.delete(&store::with_task(after.submitted_prefix(), *id));
    let prefix = store::ended_prefix(service);
    ctx.put(&store::with_time(prefix.clone(), ended, *id), Bytes::new());
    let ended = ctx.range(&prefix, ENDED_KEPT + 1);
    if let Some((oldest, _)) = ended.first().filter(|_| ended.len() > ENDED_KEPT) {
        ctx.delete(oldest);
        if let Some((_, id)) = store::parse_task(oldest, &prefix) {
            ctx.delete(&store::task_key(id));
            ctx.delete(&store::points_key(id));
        }
    }
    Ok(())
}

/// A task, if it is kept.
pub(crate) fn find(ctx: &Context<'_>, id: u64) -> Result<Option<Kept>, Rejection> {
    store::read(ctx, &store::task_key(id))
}

/// The points of a task.
pub(crate) fn points(ctx: &Context<'_>, id: u64) -> Result<Vec<Point>, Rejection> {
    Ok(store::read(ctx, &store::points_key(id))?.unwrap_or_default())
}

/// The numbers of the open tasks of a service, at most so many.
pub(crate) fn open(ctx: &Context<'_>, service: &str, most: usize) -> Vec<u64> {
    behind(ctx, &store::open_prefix(service), most).into_iter().map(|(_, id)| id).collect()
}

/// The numbers of the open tasks of a certificate.
pub(crate) fn of_certificate(ctx: &Context<'_>, issuer: &[u8; 32], serial: &[u8]) -> Vec<u64> {
    behind(ctx, &store::submitted_prefix(issuer, serial), usize::MAX).into_iter().map(|(_, id)| id).collect()
}

/// How many open tasks the certificate of this principal has.
pub(crate) fn count_of(ctx: &Context<'_>, principal: &Principal) -> usize {
    ctx.range(&submitted_prefix(principal), usize::MAX).len()
}

/// The tasks of a service that join the line or expire next, each with that time (block time, microseconds).
pub(crate) fn next(ctx: &Context<'_>, service: &str, most: usize) -> Vec<(u64, u64)> {
    behind(ctx, &store::times_prefix(service), most)
}

fn behind(ctx: &Context<'_>, prefix: &[u8], most: usize) -> Vec<(u64, u64)> {
    ctx.range(prefix, most).iter().filter_map(|(key, _)| store::parse_task(key, prefix)).collect()
}
