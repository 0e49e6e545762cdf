//! Blocks in batches: each confirmed before it is stored, each stored before it is executed.

use crate::executor::Executor;
use ledger::block::Header;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::block_store::{BlockStore, StoreError};
use ledger_storage::entry::{Entry, HardState};
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::Tip;

/// Bytes of blocks that are stored and executed at once.
const BATCH_BYTES: usize = 4 << 20;
/// Blocks in a batch at most: many may be empty.
const BATCH_BLOCKS_MAX: usize = 16_384;
/// Results and world state in memory that are stored before going on.
const PENDING_BYTES_MAX: usize = 16 << 20;

/// Where the verified chain ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct End {
    pub height: u64,
    pub term: u64,
    pub time: u64,
    pub hash: Hash,
}

impl End {
    pub(super) fn of(tip: &Tip) -> Self {
        Self { height: tip.height, term: tip.term, time: tip.time, hash: tip.hash }
    }
}

/// Blocks that follow an end, with the end that they lead to.
#[derive(Debug)]
pub struct Batch {
    entries: Vec<Entry>,
    hashes: Vec<Hash>,
    bytes: usize,
    end: End,
}

impl Batch {
    pub(super) fn after(end: End) -> Self {
        Self { entries: Vec::new(), hashes: Vec::new(), bytes: 0, end }
    }

    /// The blocks.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    pub(super) fn end(&self) -> End {
        self.end
    }

    pub(super) fn is_full(&self) -> bool {
        self.bytes >= BATCH_BYTES || self.entries.len() >= BATCH_BLOCKS_MAX
    }

    /// Adds a block, if it can be the next one.
    pub(super) fn push(&mut self, entry: Entry) -> Result<(), Rejection> {
        let end = self.end;
        if entry.index != end.height + 1 || entry.term < end.term {
            return Err(Rejection::new(Code::ChainInvalid, "a fetched block does not follow the one before it")
                .found(format!("height {} of term {}", entry.index, entry.term))
                .wanted(format!("height {} of term {} or later", end.height + 1, end.term)));
        }
        let header = Header::following(end.hash, end.time, &entry);
        self.end = End { height: entry.index, term: entry.term, time: header.time, hash: header.hash() };
        self.bytes += entry.data.len();
        self.entries.push(entry);
        self.hashes.push(self.end.hash);
        Ok(())
    }

    /// Stores the blocks and executes them.
    ///
    /// # Errors
    /// [`Code::DiskFull`] before anything is executed: to be tried again. Everything else ends the node.
    pub fn take_in(&self, store: &BlockStore, executor: &Executor, snapshots: &Snapshots) -> Result<(), Rejection> {
        self.store(store)?;
        self.execute(|entry| Ok(executor.execute(entry)?.hash))?;
        if executor.ledger().pending_bytes() > PENDING_BYTES_MAX {
            match executor.ledger().flush(Some(snapshots)) {
                // It stays in memory; the blocks have it.
                Err(fault) if fault.code == Code::DiskFull => {}
                stored => stored?,
            }
        }
        Ok(())
    }

    /// Makes the blocks durable as committed. Blocks that the log has already stay: entries of the same index and term are
    /// the same (Raft §5.3, log matching). Blocks behind them may have been acknowledged.
    ///
    /// # Errors
    /// As [`BlockStore::flush`]. With a full disk it can be done again.
    pub fn store(&self, store: &BlockStore) -> Result<(), StoreError> {
        let known = self.entries.iter().take_while(|entry| store.term(entry.index) == Some(entry.term)).count();
        let HardState { term, vote, .. } = store.hard_state();
        let newer = self.end.term > term;
        // A vote belongs to its term.
        let hard_state = HardState {
            term: term.max(self.end.term),
            vote: if newer { 0 } else { vote },
            commit: self.end.height.max(store.hard_state().commit),
        };
        store.append(self.entries.get(known..).unwrap_or_default(), Some(&hard_state))?;
        store.flush()?;
        store.set_committed(self.end.height);
        Ok(())
    }

    /// Executes the blocks with `execute`, which answers the hash of the block.
    ///
    /// # Errors
    /// Those of `execute`; [`Code::Internal`] if it finds another hash than the verified chain has.
    pub fn execute(&self, mut execute: impl FnMut(&Entry) -> Result<Hash, Rejection>) -> Result<(), Rejection> {
        for (entry, hash) in self.entries.iter().zip(&self.hashes) {
            let found = execute(entry)?;
            if found != *hash {
                return Err(Rejection::new(Code::Internal, format!("block {} has two hashes", entry.index))
                    .found(found.to_string())
                    .wanted(hash.to_string()));
            }
        }
        Ok(())
    }
}
