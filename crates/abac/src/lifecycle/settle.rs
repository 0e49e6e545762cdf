//! The loop that carries out the follow-ups of changes, until none is left.
//!
//! Every end passes through it. A grant ends when it is released, preempted, overridden, passed on, revoked or expired; a task ends with
//! its grant or its position in the queue. Follow-ups of a change come before changes that were due after it.

use super::capacity::{self, ENDINGS_MAX};
use super::follow_up::FollowUp;
use super::{grants, tasks};
use ledger::Context;
use ledger_base::rejection::Rejection;
use ledger_contract::Released;
use std::collections::VecDeque;

/// Does these and all that follows from them. Answers with the grants whose end was reported now.
pub(crate) fn settle(
    ctx: &mut Context<'_>,
    first: impl IntoIterator<Item = FollowUp>,
) -> Result<Vec<Released>, Rejection> {
    let mut due: VecDeque<FollowUp> = first.into_iter().collect();
    let mut released = Vec::new();
    while let Some(next) = due.pop_front() {
        let follows = match next {
            FollowUp::End(ending) if ending.may_wait && (released.len() >= ENDINGS_MAX || capacity::is_full(ctx)) => {
                grants::mark_ended(ctx, &ending)?;
                None
            }
            FollowUp::End(ending) => {
                let (ended, follows) = grants::end(ctx, *ending)?;
                released.push(ended);
                follows
            }
            FollowUp::TaskRuns(id) => tasks::runs(ctx, id).map(|()| None)?,
            FollowUp::TaskGrantEnded { id, reason } => tasks::grant_ended(ctx, id, reason).map(|()| None)?,
            FollowUp::TaskLeftQueue { id, reason } => tasks::left(ctx, id, reason).map(|()| None)?,
        };
        follows.into_iter().for_each(|follow| due.push_front(follow));
    }
    Ok(released)
}
