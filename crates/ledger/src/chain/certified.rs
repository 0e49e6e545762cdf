//! Certified blocks: the voters whose signatures count, and the hashes that the next block builds on.

use super::Ledger;
use crate::msp;
use ledger_light::Voters;
use ledger_rejection::{Code, Rejection};
use ledger_storage::result::{BlockResult, Roots};
use ledger_storage::results::ResultStore;

impl Ledger {
    /// The voters as of [`Ledger::tip`]: those whose signatures count for the next block.
    ///
    /// # Errors
    /// As [`Ledger::members`].
    pub fn voters(&self) -> Result<Voters, Rejection> {
        msp::voters(&*self.state)
    }
}

/// The roots of the newest block that is to be certified: the next such block builds on them. Blocks between two of them are
/// of one window of block time, so few are looked at.
///
/// # Errors
/// A fault of the store; [`Code::Corrupt`] if results are missing.
pub(super) fn newest_roots(
    tip: u64,
    genesis: &BlockResult,
    results: &ResultStore,
    certifies: impl Fn(u64) -> bool,
) -> Result<Option<Roots>, Rejection> {
    for height in (1..=tip).rev().take_while(|height| certifies(*height)) {
        let stored = results.get(height)?.ok_or_else(|| {
            Rejection::new(Code::Corrupt, "a result is missing that the next certified block builds on")
                .found(format!("none of block {height}"))
                .next("delete the directories state/ and results/; the node makes both again from the blocks")
        })?;
        if let Some(roots) = stored.roots() {
            return Ok(Some(roots));
        }
    }
    Ok(genesis.roots())
}
