//! The stores of a node, as `ledger_replica::opening` asks for them.

use super::{Node, Shelf};
use ledger::{Ledger, Outcome};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_replica::opening::Kept;
use ledger_storage::block_store::{BlockStore, Options, StoreError};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::Entry;
use ledger_storage::results::ResultStore;
use ledger_storage::state::Store;
use std::sync::Arc;

/// World state and results of a node that starts.
pub struct Keeping<'a> {
    /// The node.
    pub node: &'a mut Node,
    /// Name of the network.
    pub network: Hash,
    /// The blocks that were executed again.
    pub replayed: Vec<(Entry, Outcome)>,
}

impl Kept for Keeping<'_> {
    fn state(&mut self) -> Result<Box<dyn Store>, Rejection> {
        Ok(Box::new(self.node.shelf.clone()))
    }

    fn results(&mut self, blocks: &Arc<BlockStore>) -> Result<ResultStore, Rejection> {
        let results = ResultStore::open(Arc::new(self.node.results.clone()), self.network)?;
        // Who drops blocks here drops them sooner than a node may (`KEPT_MIN_US`), and asks for their results afterwards.
        Ok(if self.node.keep.is_none() { results.beside(Arc::clone(blocks)) } else { results })
    }

    fn set_aside(&mut self) -> Result<(), Rejection> {
        self.node.shelf = Shelf::default();
        self.node.results = SimDisk::new(self.node.start);
        self.replayed.clear();
        Ok(())
    }

    fn replay(&mut self, ledger: &Ledger, block: &Entry) -> Result<(), Rejection> {
        let outcome = ledger.apply(block)?;
        self.replayed.push((block.clone(), outcome));
        Ok(())
    }
}

/// Opens the log of a node whose process is not running.
///
/// # Errors
/// The node's last words, and its end.
pub fn open_blocks(node: &Node, network: Hash, segment_bytes: u64, salt: u64) -> Result<BlockStore, StoreError> {
    let mut segment = salt;
    let mut options = Options::new(network.0, move || {
        segment = segment.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        segment
    });
    options.segment_bytes = segment_bytes;
    // Small, so that old blocks are really read from the disk.
    options.cache_bytes = 64 * 1024;
    Ok(BlockStore::open(Arc::new(node.disk.clone()), options)?.0)
}
