//! The data of a ledger on disk: storing it, making snapshots of it, dropping the oldest.

use super::Ledger;
use crate::foretold::Completing;
use crate::transaction::NOT_AFTER_AHEAD_MAX;
use ledger_base::rejection::Rejection;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::Tip;
use std::sync::PoisonError;

/// Block time between two snapshots for each block that a network wants between them, in microseconds, at least; but no
/// more than the time whose results a snapshot holds. Under load those are millions, and a snapshot every few seconds
/// would be more work than executing blocks. So each result is written into one or two snapshots, however many there
/// are.
const SNAPSHOT_TIME_PER_BLOCK: u64 = 12_000;

impl Ledger {
    /// Roughly how many bytes of results and world state wait for a [`flush`](Self::flush).
    pub fn pending_bytes(&self) -> usize {
        self.state.dirty_bytes() + self.results.pending_bytes()
    }

    /// Stores everything that was executed when it was called, first the results, and waits for the disk. Makes the
    /// snapshots that are due on the way. Runs beside everything else.
    ///
    /// # Errors
    /// [`Code::DiskFull`](ledger_base::rejection::Code::DiskFull), [`Code::DiskFailed`](ledger_base::rejection::Code::DiskFailed):
    /// nothing is lost, the blocks have it.
    pub fn flush(&self, snapshots: Option<&Snapshots>) -> Result<(), Rejection> {
        self.flush_up_to(u64::MAX, snapshots)
    }

    /// As [`flush`](Self::flush), but nothing that was executed above the height `durable`: what is stored must never
    /// be ahead of the log on the disk.
    ///
    /// # Errors
    /// As [`flush`](Self::flush).
    pub fn flush_up_to(&self, durable: u64, snapshots: Option<&Snapshots>) -> Result<(), Rejection> {
        let _one = self.flushing.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = self.tip().height;
        loop {
            let stored = self.state.stored();
            if let (Some(tip), Some(snapshots)) = (&stored, snapshots) {
                self.snapshot(tip, snapshots);
            }
            if stored.is_some_and(|stored| stored.height >= wanted) {
                return Ok(());
            }
            let Some(layer) = self.state.next_layer().filter(|layer| layer.tip.height <= durable) else {
                return Ok(());
            };
            self.results.flush(layer.tip.height)?;
            self.state.store(&layer)?;
        }
    }

    /// Makes the snapshot of what is stored, if one is due and not there yet.
    fn snapshot(&self, stored: &Tip, snapshots: &Snapshots) {
        if !self.is_snapshot_due(stored) {
            return;
        }
        let since = stored.time.saturating_sub(NOT_AFTER_AHEAD_MAX);
        let mut completing = Completing::new(&self.results, &self.registry, stored.height);
        let mut complete = |height, result| completing.complete(height, result);
        if let Err(fault) = snapshots.make(stored, &self.state, (&self.results, since), &mut complete) {
            // The next one may succeed; blocks are kept until one does.
            tracing::error!(height = stored.height, code = fault.code.name(), reason = %fault, "cannot make a snapshot");
        }
    }

    /// Is there to be a snapshot of the state after this block? Follows from the chain, so that all nodes make the
    /// same. A node that cannot read what tells it goes on without the snapshot.
    pub(super) fn is_snapshot_due(&self, tip: &Tip) -> bool {
        let every = self.snapshot_every;
        if tip.height == 0 || !tip.height.is_multiple_of(every) {
            return false;
        }
        let period = every.saturating_mul(SNAPSHOT_TIME_PER_BLOCK).min(NOT_AFTER_AHEAD_MAX);
        match self.block_hashes(tip.height - every) {
            Ok(Some(before)) => before.time / period != tip.time / period,
            // What is not kept any more is older than the longest period.
            Ok(None) => true,
            Err(fault) => {
                tracing::error!(height = tip.height, code = fault.code.name(), reason = %fault, "no snapshot: cannot \
                                                                                                 determine whether \
                                                                                                 one is due");
                false
            }
        }
    }

    /// Drops old results, in whole files: those of blocks below `keep_from` that are not needed to find duplicates.
    /// Answers with the height of the oldest result that is left.
    ///
    /// # Errors
    /// [`Code::DiskFailed`](ledger_base::rejection::Code::DiskFailed).
    pub fn prune_results(&self, keep_from: u64) -> Result<u64, Rejection> {
        self.results.prune(keep_from, self.tip().time.saturating_sub(NOT_AFTER_AHEAD_MAX))
    }
}
