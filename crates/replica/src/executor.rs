//! Execution: applies committed blocks, and tells everybody whom it concerns.

use crate::budgets::Budgets;
use ledger::{Ledger, Outcome};
use ledger_base::rejection::Rejection;
use ledger_base::{costly_invariant, invariant};
use ledger_raft::{ExecutedBlocks, Link};
use ledger_storage::entry::Entry;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes of blocks that are verified together at least, if so many wait: about as many signatures as it takes until more
/// cost no less.
const TURN_BYTES: usize = 16 * 1024;

/// Sees every executed block, in order of height, before the next one is executed.
pub trait Observer: Send + Sync {
    /// The block was executed. The ledger stands at its height.
    fn executed(&self, outcome: &Arc<Outcome>, ledger: &Ledger);
}

/// Executes blocks. One thread at a time may do so; everything else may be asked beside that.
pub struct Executor {
    ledger: Arc<Ledger>,
    /// In the order in which they see a block.
    observers: Vec<Arc<dyn Observer>>,
    /// Counts every block before the observers see it.
    budgets: Arc<Budgets>,
    /// Block time at which a chaincode has something to do next, as of the newest block; [`u64::MAX`] if never.
    deadline: AtomicU64,
}

impl Executor {
    /// Of this ledger. The first observers see a block first: those whom somebody waits for.
    pub fn new(ledger: Arc<Ledger>, observers: Vec<Arc<dyn Observer>>) -> Self {
        let executor = Self { ledger, observers, budgets: Arc::default(), deadline: AtomicU64::new(u64::MAX) };
        executor.look_at_deadline();
        executor
    }

    /// The same, counting for these budgets.
    #[must_use]
    pub fn counting(self, budgets: Arc<Budgets>) -> Self {
        Self { budgets, ..self }
    }

    /// How much identities, organisations and services have sent.
    pub fn budgets(&self) -> &Arc<Budgets> {
        &self.budgets
    }

    /// The ledger that blocks are applied to.
    pub fn ledger(&self) -> &Arc<Ledger> {
        &self.ledger
    }

    /// Executes one committed block and tells everybody whom it concerns.
    ///
    /// # Errors
    /// As [`Ledger::apply`]: the node must stop then.
    pub fn execute(&self, entry: &Entry) -> Result<Arc<Outcome>, Rejection> {
        let outcome = Arc::new(self.ledger.apply(entry)?);
        let (wanted, executed) = (entry.index, outcome.header.height);
        invariant!(executed == wanted, "a block is executed at its own height", "block {wanted} at {executed}");
        costly_invariant!(
            self.ledger.tip().height == wanted,
            "the ledger stands at the block that it has executed",
            "it stands at {} after block {wanted}",
            self.ledger.tip().height
        );
        self.budgets.executed(&outcome, &self.ledger);
        for observer in &self.observers {
            observer.executed(&outcome, &self.ledger);
        }
        Ok(outcome)
    }

    /// Executes blocks that follow each other.
    ///
    /// # Errors
    /// As [`Executor::execute`].
    pub fn execute_all(&self, entries: &[Entry]) -> Result<(), Rejection> {
        for entry in entries {
            self.execute(entry)?;
            self.look_at_deadline();
        }
        Ok(())
    }

    /// The block time at which a chaincode has something to do next, microseconds; [`u64::MAX`] if never.
    pub fn deadline(&self) -> u64 {
        self.deadline.load(Ordering::Relaxed)
    }

    /// Reads the next deadline again. Needed after blocks that were executed by [`Executor::execute`].
    pub fn look_at_deadline(&self) {
        self.deadline.store(self.ledger.next_deadline().unwrap_or(u64::MAX), Ordering::Relaxed);
    }
}

impl ExecutedBlocks for Executor {
    fn link(&self, height: u64) -> Option<Link> {
        let tip = self.ledger.tip();
        if height == tip.height {
            return Some(Link { hash: tip.hash, time: tip.time });
        }
        let block = self.ledger.block_hashes(height);
        let block = block.inspect_err(|fault| {
            tracing::error!(height, code = fault.code.name(), reason = %fault, "cannot read the hash of an executed block")
        });
        block.ok()?.map(|block| Link { hash: block.hash, time: block.time })
    }
}

/// Blocks in groups that are verified together ([`Ledger::verify_blocks`]), and told to be executed together.
pub fn in_turns(entries: &[Entry]) -> impl Iterator<Item = &[Entry]> {
    let mut bytes = 0;
    entries.chunk_by(move |entry, _| {
        bytes += entry.data.len();
        let another = bytes < TURN_BYTES;
        if !another {
            bytes = 0;
        }
        another
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_storage::entry::EntryKind;

    fn blocks(count: usize, bytes: usize) -> Vec<Entry> {
        let entry = |index| Entry { index, term: 1, kind: EntryKind::Normal, data: vec![0; bytes].into() };
        (1..).map(entry).take(count).collect()
    }

    #[test]
    fn blocks_are_executed_in_order_and_in_groups_worth_verifying_together() {
        let lengths = |blocks: &[Entry]| in_turns(blocks).map(<[Entry]>::len).collect::<Vec<_>>();
        assert!(lengths(&[]).is_empty());
        assert_eq!(lengths(&blocks(1, 10 * TURN_BYTES)), [1]);
        assert_eq!(lengths(&blocks(3, TURN_BYTES)), [1, 1, 1], "each is worth it alone");
        assert_eq!(lengths(&blocks(10, TURN_BYTES / 4)), [4, 4, 2]);
        let many = blocks(1000, 300);
        let in_turns: Vec<_> = in_turns(&many).flatten().collect();
        assert!(in_turns.iter().map(|entry| entry.index).eq(1..=1000));
    }
}
