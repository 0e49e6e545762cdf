//! The blocks that results are kept beside.

use crate::block_store::BlockStore;
use crate::entry::Entry;
use ledger_base::rejection::Rejection;
use std::ops::Range;

/// Where the blocks are that results are kept beside.
pub trait Blocks: Send + Sync {
    /// The blocks of these heights that are kept, in order: as many as fit into `bytes_max`, but one at least.
    ///
    /// # Errors
    /// A fault of the disk.
    fn blocks(&self, heights: Range<u64>, bytes_max: usize) -> Result<Vec<Entry>, Rejection>;
}

impl Blocks for BlockStore {
    fn blocks(&self, heights: Range<u64>, bytes_max: usize) -> Result<Vec<Entry>, Rejection> {
        Ok(self.entries(heights, bytes_max)?)
    }
}
