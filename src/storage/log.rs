//! Durable writes of the log.

use crate::process::meters::observe;
use crate::storage::space::Space;
use ledger_replica::space::Wrote;
use ledger_storage::block_store::{BlockStore, StoreError};
use prometheus_client::metrics::histogram::Histogram;
use std::sync::Arc;
use std::time::Instant;

/// The log, on a disk that may be full; cheap to clone.
#[derive(Clone)]
pub(crate) struct Log {
    /// The blocks.
    pub store: Arc<BlockStore>,
    /// The room that the disk still has.
    pub space: Arc<Space>,
    /// Takes down how long a flush takes.
    pub flushed: Histogram,
}

impl Log {
    /// Makes the log durable. A disk without room gets the reserve first.
    ///
    /// # Errors
    /// As [`BlockStore::flush`]; [`StoreError::DiskFull`] if the reserve is used up.
    pub(crate) fn flush(&self) -> Result<(), StoreError> {
        loop {
            let since = Instant::now();
            let written = self.store.flush().map(drop);
            observe(&self.flushed, since);
            if !self.space.wrote(Wrote::from(&written)) {
                return written;
            }
        }
    }
}
