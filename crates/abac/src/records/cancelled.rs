//! Stops that a `resume` has cancelled before they were ordered.

use super::store;
use ledger::transaction::NOT_AFTER_AHEAD_MAX;
use ledger::{CallRef, Context};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Most cancelled stops of a robot that are remembered at a time.
const CANCELLED_MAX: usize = 256;

/// A stop that has no effect when it is ordered.
#[derive(Serialize, Deserialize)]
struct Cancelled {
    id: Hash,
    /// Microseconds since the UNIX epoch.
    not_after: u64,
}

/// Was this stop of the robot cancelled?
///
/// # Errors
/// [`Code::Corrupt`] if the state cannot be read.
pub(crate) fn has(ctx: &Context<'_>, robot: &str, id: &Hash) -> Result<bool, Rejection> {
    Ok(read(ctx, robot)?.iter().any(|cancelled| cancelled.id == *id))
}

/// Cancels those of the calls that are not settled. Answers whether there was one.
///
/// # Errors
/// [`Code::LimitExceeded`] if too many are cancelled at a time; [`Code::Corrupt`] if the state cannot be read.
pub(crate) fn cancel(ctx: &mut Context<'_>, robot: &str, calls: &[CallRef]) -> Result<bool, Rejection> {
    let open: Vec<_> = calls.iter().filter(|call| !ctx.is_settled(&call.id, call.not_after)).collect();
    if open.is_empty() {
        return Ok(false);
    }
    let (time, mut all) = (ctx.block_time(), read(ctx, robot)?);
    all.retain(|cancelled| cancelled.not_after >= time);
    for call in open {
        if !all.iter().any(|cancelled| cancelled.id == call.id) {
            let not_after = call.not_after.min(time.saturating_add(NOT_AFTER_AHEAD_MAX));
            all.push(Cancelled { id: call.id, not_after });
        }
    }
    if all.len() > CANCELLED_MAX {
        return Err(Rejection::new(Code::LimitExceeded, format!("too many cancelled stops of {robot}"))
            .found(all.len().to_string())
            .wanted(format!("at most {CANCELLED_MAX}"))
            .next("wait until the older ones have expired, two minutes at most"));
    }
    store::write(ctx, &store::cancelled_key(robot), &all)?;
    Ok(true)
}

fn read(ctx: &Context<'_>, robot: &str) -> Result<Vec<Cancelled>, Rejection> {
    Ok(store::read(ctx, &store::cancelled_key(robot))?.unwrap_or_default())
}
