//! Certified blocks: the voters whose signatures count, and the hashes that the next block builds on.

use super::{BlockHashes, Ledger};
use crate::facts::{self, ControlWrites, Facts};
use crate::msp;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::fact::Fact;
use ledger_light::proof::Shown;
use ledger_light::{Change, Voters};
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

    /// The number of forced recoveries as of [`Ledger::tip`].
    ///
    /// # Errors
    /// As [`Ledger::members`].
    pub fn recoveries(&self) -> Result<u64, Rejection> {
        msp::recoveries(&*self.state)
    }

    /// The changes of who governs after a height, oldest first, at most so many.
    ///
    /// # Errors
    /// As [`Ledger::members`].
    pub fn changes(&self, after: u64, most: usize) -> Result<Vec<Change>, Rejection> {
        msp::changes(&*self.state, after, most)
    }

    /// All governing state as it is, for a checkpoint of the block at this height: none has changed it since.
    ///
    /// # Errors
    /// As [`Ledger::members`].
    pub fn governing(&self, height: u64) -> Result<Change, Rejection> {
        facts::governing(&*self.state, &self.registry, height)
    }

    /// Facts of a certified block with their paths: the ground, then what `wanted` names. None if the block is not due to be
    /// certified, or was executed too long ago to say what it wrote ([`Ledger::writes`]).
    ///
    /// # Errors
    /// A fault of the store.
    pub fn shown(&self, height: u64, wanted: impl Fn(&Fact<'_>) -> bool) -> Result<Option<Vec<Shown>>, Rejection> {
        let Some(result) = self.result(height)? else { return Ok(None) };
        let (Some(after), Some(writes)) = (result.roots(), self.writes(height)) else { return Ok(None) };
        let writes = ControlWrites::among(writes.iter().map(|write| (&write.key, write.value)), &self.registry);
        let Some(before) = self.roots_before(height)? else { return Ok(None) };
        let facts = Facts::new((&before, &after), result.digest(), (&result.results, &result.events), &writes);
        let leaves = facts.leaves();
        let found = (1u32..).zip(&facts.others).filter(|(_, fact)| wanted(fact));
        let shown = std::iter::once((0, &facts.ground)).chain(found);
        Ok(shown.map(|(index, fact)| Shown::of(fact, &leaves, index)).collect())
    }

    /// The roots that a certified block was built on.
    fn roots_before(&self, height: u64) -> Result<Option<Roots>, Rejection> {
        for before in (0..height).rev() {
            match self.block_hashes(before)? {
                Some(BlockHashes { roots: Some(roots), .. }) => return Ok(Some(roots)),
                Some(_) => {}
                None => return Ok(None),
            }
        }
        Ok(None)
    }
}

/// The roots of the newest block that is to be certified: the next such block builds on them. Blocks between two of them are
/// of one window of block time, so few are looked at.
///
/// # Errors
/// A fault of the store; [`Code::Corrupt`] if results are missing.
pub(super) fn newest_roots(tip: u64, genesis: &BlockResult, results: &ResultStore) -> Result<Roots, Rejection> {
    for height in (1..=tip).rev() {
        let stored = results.get(height)?.ok_or_else(|| {
            Rejection::new(Code::Corrupt, "a result needed for the next certificate is missing")
                .found(format!("none of block {height}"))
                .next(
                    "delete the directories state/ and results/ while the node is stopped; both are rebuilt from \
                       the blocks",
                )
        })?;
        if let Some(roots) = stored.roots() {
            return Ok(roots);
        }
    }
    genesis.roots().ok_or_else(|| Rejection::new(Code::Internal, "the genesis has no root certificates"))
}
