//! Drops old blocks and their results, as the setting `storage.retention` wants; archives them first if there is an
//! archive.

use crate::storage::space::Space;
use ledger::Ledger;
use ledger::network::Genesis;
use ledger_base::rejection::Rejection;
use ledger_replica::space::Measured;
use ledger_replica::trust;
use ledger_storage::archive::{Extent, archive};
use ledger_storage::block_store::BlockStore;
use ledger_storage::retention::{Kept, Retention};
use ledger_storage::snapshot::Snapshots;
use std::path::PathBuf;
use std::sync::Arc;

/// With less than this part of the disk free, blocks are dropped that no two organisations have attested yet.
const FREE_MIN: u64 = 4;

/// The settings and stores that decide about old blocks.
pub(crate) struct Pruner {
    pub ledger: Arc<Ledger>,
    pub store: Arc<BlockStore>,
    pub snapshots: Arc<Snapshots>,
    pub space: Arc<Space>,
    pub retention: Retention,
    /// Where finished segments are copied to before they are dropped.
    pub archive: Option<PathBuf>,
    /// The data directory.
    pub data: PathBuf,
}

impl Pruner {
    /// Drops what is not to be kept any more.
    ///
    /// # Errors
    /// If the archive cannot be written: then nothing is dropped. A fault of the store.
    pub(crate) fn prune(&self) -> Result<(), Rejection> {
        if self.retention == Retention::FOREVER {
            return Ok(());
        }
        let Measured { free, total } = self.space.measured();
        let limit = trust::needless(&self.ledger, &self.snapshots, free < total / FREE_MIN)?;
        let time_of = |height| self.ledger.block_hashes(height).ok().flatten().map(|block| block.time);
        let keep_from = self.retention.keep_from(&Kept {
            finished: &self.store.finished(),
            oldest_snapshot: limit,
            time: self.ledger.tip().time,
            time_of: &time_of,
        });
        if keep_from <= self.store.first_index() {
            // A node that ended between the two drops what it has left.
            return self.ledger.prune_results(self.store.first_index()).map(drop);
        }
        if let Some(to) = &self.archive {
            let report = archive((&self.data, to), Extent::Finished, &Genesis::network_of, &mut |_| ())?;
            tracing::info!(segments = report.segments_copied, up_to = report.last_height, "blocks archived");
        }
        let first = self.store.prune(keep_from)?;
        self.ledger.prune_results(first)?;
        tracing::info!(first, "older blocks dropped");
        Ok(())
    }
}
