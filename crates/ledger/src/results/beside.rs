//! The blocks that results are kept beside.

use super::stored::StoredResult;
use super::window::Place;
use crate::block_store::BlockStore;
use crate::chaincode::Registry;
use crate::entry::Entry;
use crate::rejection::Rejection;
use crate::result::{BlockResult, TransactionResult};
use std::collections::VecDeque;
use std::ops::Range;

/// Bytes of blocks that are read at once while many results are completed.
const AHEAD_BYTES: usize = 256 * 1024;

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

/// Completes results with their blocks, which it reads many at once.
pub(crate) struct Completing<'a> {
    blocks: Option<&'a dyn Blocks>,
    registry: &'a Registry,
    /// No result above this height will be asked for.
    last: u64,
    read: VecDeque<Entry>,
}

impl<'a> Completing<'a> {
    /// For results up to a height.
    pub(super) fn new(blocks: Option<&'a dyn Blocks>, registry: &'a Registry, last: u64) -> Self {
        Self { blocks, registry, last, read: VecDeque::new() }
    }

    /// The whole result of a height; none if its block was dropped. Heights grow from call to call.
    ///
    /// # Errors
    /// [`Code::Corrupt`](crate::Code::Corrupt) if the two do not belong together; a fault of the disk.
    pub(crate) fn complete(&mut self, height: u64, stored: StoredResult) -> Result<Option<BlockResult>, Rejection> {
        if !stored.is_short() {
            return Ok(stored.into_whole());
        }
        let block = self.block(height)?;
        block.map(|block| stored.complete(&block, self.registry)).transpose()
    }

    /// What became of one transaction; none if its block was dropped.
    ///
    /// # Errors
    /// As [`Completing::complete`].
    pub(super) fn transaction(
        &mut self,
        place: Place,
        stored: StoredResult,
    ) -> Result<Option<TransactionResult>, Rejection> {
        if !stored.is_short() {
            let whole = stored.into_whole();
            return Ok(whole.and_then(|block| block.results.into_iter().nth(place.position as usize)));
        }
        let Some(block) = self.block(place.height)? else { return Ok(None) };
        stored.transaction(place.position, &block, self.registry)
    }

    fn block(&mut self, height: u64) -> Result<Option<Entry>, Rejection> {
        let Some(blocks) = self.blocks else { return Ok(None) };
        while self.read.pop_front_if(|entry| entry.index < height).is_some() {}
        if self.read.is_empty() {
            self.read = blocks.blocks(height..self.last.max(height) + 1, AHEAD_BYTES)?.into();
        }
        Ok(self.read.pop_front_if(|entry| entry.index == height))
    }
}
