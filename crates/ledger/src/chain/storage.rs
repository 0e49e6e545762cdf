//! What a ledger keeps on disk: storing it, snapshots of it, dropping what is old.

use super::Ledger;
use crate::rejection::Rejection;
use crate::snapshot::Snapshots;
use crate::state::Tip;
use crate::transaction::NOT_AFTER_AHEAD_MAX;
use std::sync::PoisonError;

impl Ledger {
    /// Roughly how many bytes of results and world state wait for a [`flush`](Self::flush).
    pub fn pending_bytes(&self) -> usize {
        self.state.dirty_bytes() + self.results.pending_bytes()
    }

    /// Stores everything that was executed when it was called, first the results, and waits for the disk. Makes the
    /// snapshots that are due on the way. Runs beside everything else.
    ///
    /// # Errors
    /// [`Code::DiskFull`](crate::Code::DiskFull), [`Code::DiskFailed`](crate::Code::DiskFailed): nothing is lost, the blocks have it.
    pub fn flush(&self, snapshots: Option<&Snapshots>) -> Result<(), Rejection> {
        self.flush_up_to(u64::MAX, snapshots)
    }

    /// As [`flush`](Self::flush), but nothing that was executed above the height `durable`: what is stored must never be
    /// ahead of the log on the disk.
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
        if stored.height == 0 || !stored.height.is_multiple_of(self.snapshot_every) {
            return;
        }
        if let Err(fault) = snapshots.make(stored, &self.state, (&self.results, &self.registry)) {
            // The next one may succeed; blocks are kept until one does.
            tracing::error!(height = stored.height, %fault, "cannot make a snapshot");
        }
    }

    /// Drops old results, in whole files: those of blocks below `keep_from` that are not needed to find duplicates.
    /// Answers with the height of the oldest result that is left.
    ///
    /// # Errors
    /// [`Code::DiskFailed`](crate::Code::DiskFailed).
    pub fn prune_results(&self, keep_from: u64) -> Result<u64, Rejection> {
        self.results.prune(keep_from, self.tip().time.saturating_sub(NOT_AFTER_AHEAD_MAX))
    }
}
