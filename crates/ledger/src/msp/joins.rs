//! How many new nodes an organisation brings in: each one costs the others two changes of the members, and a copy of the state.
//!
//! A node that replaces its old record, or comes again after its removal, is a new one. So members that come and go without end
//! are bounded, whichever way they go.

use super::store::{self, joins_key};
use crate::chaincode::Context;
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Most new nodes of one organisation in [`JOINS_TIME`].
pub const JOINS_MAX: u64 = 64;
/// An hour of block time, microseconds.
pub const JOINS_TIME: u64 = 3600 * 1_000_000;

/// The new nodes of an organisation, as they stand on the ledger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Joins {
    /// Block time of the first one that counts, microseconds.
    since: u64,
    /// How many there were since, with that one.
    count: u64,
}

/// Counts a new node of this organisation.
///
/// # Errors
/// [`Code::LimitExceeded`] if it had too many lately.
pub(super) fn count(ctx: &mut Context<'_>, organisation: &str) -> Result<(), Rejection> {
    let (key, now) = (joins_key(organisation), ctx.block_time());
    let before = store::read::<Joins>(ctx, &key)?.filter(|joins| now < joins.since.saturating_add(JOINS_TIME));
    let Joins { since, count } = before.unwrap_or(Joins { since: now, count: 0 });
    if count >= JOINS_MAX {
        let left = (since.saturating_add(JOINS_TIME) - now).div_ceil(60 * 1_000_000);
        return Err(Rejection::new(Code::LimitExceeded, format!("too many nodes of {organisation} joined recently"))
            .found(format!("{count} new nodes within the hour"))
            .wanted(format!("at most {JOINS_MAX} new nodes per organisation and hour"))
            .next(format!("try again in {left} min")));
    }
    store::write(ctx, &key, &Joins { since, count: count + 1 })
}
