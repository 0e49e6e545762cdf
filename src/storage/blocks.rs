//! Executed blocks for those who read them: recent ones from memory, older ones from the block store and the results
//! kept beside it.

mod interest;

pub(crate) use interest::Interest;

use interest::Interests;
use ledger::block::{Header, content};
use ledger::{Ledger, Outcome};
use ledger_base::rejection::{Code, Rejection};
use ledger_replica::Observer;
use ledger_storage::block_store::BlockStore;
use ledger_storage::result::TransactionResult;
use std::collections::VecDeque;
use std::sync::{Arc, PoisonError, RwLock};
use tokio::sync::{Notify, watch};

/// Blocks kept in memory for subscribers that keep up. A small one takes about 1.2 KiB with what it did.
const RECENT_BLOCKS_MAX: usize = 1024;
/// Bytes of transactions kept in memory with them.
const RECENT_BYTES_MAX: usize = 4 * 1024 * 1024;

/// Executed blocks by height.
pub(crate) struct Blocks {
    ledger: Arc<Ledger>,
    store: Arc<BlockStore>,
    recent: RwLock<Newest>,
    head: watch::Sender<u64>,
    /// Told when half of what fits into memory has come since the last time.
    half_forgotten: Notify,
    interests: Arc<Interests>,
}

#[derive(Default)]
struct Newest {
    outcomes: VecDeque<Arc<Outcome>>,
    bytes: usize,
    /// Bytes that came since somebody was told.
    came: usize,
}

impl Blocks {
    /// The blocks of a ledger, of which none is in memory yet.
    pub(crate) fn new(ledger: Arc<Ledger>, store: Arc<BlockStore>) -> Self {
        let head = watch::Sender::new(ledger.tip().height);
        Self {
            ledger,
            store,
            recent: RwLock::default(),
            head,
            half_forgotten: Notify::new(),
            interests: Arc::default(),
        }
    }

    /// Takes the block that was executed last and wakes everybody who waits for it, or for one of its events.
    fn publish(&self, outcome: Arc<Outcome>) {
        let height = outcome.header.height;
        let events = Arc::clone(&outcome);
        {
            let mut recent = self.recent.write().unwrap_or_else(PoisonError::into_inner);
            let bytes = bytes_of(&outcome);
            recent.bytes += bytes;
            recent.came += bytes;
            if recent.came > RECENT_BYTES_MAX / 2 {
                recent.came = 0;
                self.half_forgotten.notify_one();
            }
            recent.outcomes.push_back(outcome);
            while recent.outcomes.len() > RECENT_BLOCKS_MAX || recent.bytes > RECENT_BYTES_MAX {
                let Some(oldest) = recent.outcomes.pop_front() else { break };
                recent.bytes -= bytes_of(&oldest);
            }
        }
        let concerned = {
            let table = self.interests.lock();
            let concerned = table.mark(height, events.events.iter().map(|emitted| emitted.event.subject.as_str()));
            self.head.send_replace(height);
            concerned
        };
        for mark in concerned {
            mark.wake();
        }
    }

    /// Enters somebody who waits for events about these subjects, or about everything if there are none.
    pub(crate) fn interest(&self, subjects: Vec<String>) -> Interest {
        let mut table = self.interests.lock();
        let height = self.height();
        self.interests.enter(&mut table, subjects, height)
    }

    /// Height of the last block that readers find here.
    pub(crate) fn height(&self) -> u64 {
        *self.head.borrow()
    }

    /// Follows the height of the last executed block.
    pub(crate) fn head(&self) -> watch::Receiver<u64> {
        self.head.subscribe()
    }

    /// Waits until so many bytes came that half of the recent blocks are no longer in memory. For one who follows.
    pub(crate) async fn half_forgotten(&self) {
        self.half_forgotten.notified().await;
    }

    /// The block at a height; none if it was not executed yet, or if it is the genesis.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn get(&self, height: u64) -> Result<Option<Arc<Outcome>>, Rejection> {
        match self.recent(height) {
            Some(outcome) => Ok(Some(outcome)),
            None => Ok(self.stored(height)?.map(Arc::new)),
        }
    }

    /// The oldest block that is kept.
    pub(crate) fn first_height(&self) -> u64 {
        self.store.first_index()
    }

    /// The block at a height, if it is in memory.
    pub(crate) fn recent(&self, height: u64) -> Option<Arc<Outcome>> {
        let recent = self.recent.read().unwrap_or_else(PoisonError::into_inner);
        let first = recent.outcomes.front()?.header.height;
        recent.outcomes.get(usize::try_from(height.checked_sub(first)?).ok()?).map(Arc::clone)
    }

    fn stored(&self, height: u64) -> Result<Option<Outcome>, Rejection> {
        let Some(entry) = self.store.entry(height)? else { return Ok(None) };
        let Some(result) = self.ledger.result_of(&entry)? else { return Ok(None) };
        let previous = match height {
            1 => self.ledger.network(),
            _ => match self.ledger.block_hashes(height - 1)? {
                Some(before) => before.hash,
                None => return Ok(None),
            },
        };
        let (root, payload) = content(&entry);
        let header = Header { height, term: entry.term, time: result.time, previous, root };
        let (hash, digest, writes, kind) = (header.hash(), result.digest(), result.writes(), result.kind());
        if hash != result.hash() {
            return Err(Rejection::new(Code::Corrupt, format!("block {height} and its result do not belong together"))
                .found(format!("hash {hash} of the block, {} of the result", result.hash()))
                .next(
                    "stop the node and delete its directories state/ and results/; it rebuilds them from the blocks",
                ));
        }
        Ok(Some(Outcome {
            header,
            hash,
            digest,
            writes,
            kind,
            transactions: payload.unwrap_or_default().transactions,
            ids: result.results.iter().map(TransactionResult::id).collect(),
            results: result.results,
            events: result.events,
            certifiable: None,
            governs: false,
        }))
    }
}

impl Observer for Blocks {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        self.publish(Arc::clone(outcome));
    }
}

fn bytes_of(outcome: &Outcome) -> usize {
    512 + outcome.transactions.iter().map(|transaction| transaction.len() + 256).sum::<usize>()
}
