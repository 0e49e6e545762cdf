//! Where a simulated node keeps its world state: whole batches only, and nothing that was not flushed. A process that
//! dies leaves it as the last flush did.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::state::{MemoryState, StateRead, Store, WriteSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A shelf for one world state. Clones share it.
#[derive(Clone, Default)]
pub struct Shelf {
    pairs: Arc<MemoryState>,
    full: Arc<AtomicBool>,
}

impl Shelf {
    /// Makes room, or takes it.
    pub fn set_full(&self, full: bool) {
        self.full.store(full, Ordering::Relaxed);
    }
}

impl Store for Shelf {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        StateRead::get(&*self.pairs, key)
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        StateRead::range(&*self.pairs, prefix, after, limit)
    }

    fn write(&self, batch: &WriteSet, tip: (&[u8], &[u8])) -> Result<(), Rejection> {
        if self.full.load(Ordering::Relaxed) {
            return Err(Rejection::new(Code::DiskFull, "no room for the world state"));
        }
        self.pairs.write(batch, tip)
    }
}
