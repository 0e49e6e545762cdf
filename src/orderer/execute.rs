//! Execution: applies committed blocks, wakes subscribers, answers clients.

use super::Shared;
use ledger::entry::Entry;
use ledger::{Outcome, Rejection};
use ledger_raft::Input;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Bytes of blocks that are executed in place at most: some commands.
const IN_PLACE_BYTES_MAX: usize = 4096;
/// Time that executing in place may take. Heartbeats and writes must not wait for a slow chaincode.
const IN_PLACE_TIME_MAX: Duration = Duration::from_millis(1);
/// Times that nothing is executed in place after it took longer.
const HANDED_OVER_AFTERWARDS: u32 = 1000;

/// Executes committed blocks, on one thread at a time.
#[derive(Clone)]
pub(super) struct Execute {
    shared: Arc<Shared>,
    /// As of the newest block executed.
    deadline: Arc<AtomicU64>,
    /// Blocks given to the execute thread that it has not executed.
    waiting: Arc<AtomicUsize>,
}

impl Execute {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        let deadline = Arc::new(AtomicU64::new(shared.ledger.next_deadline().unwrap_or(u64::MAX)));
        Self { shared, deadline, waiting: Arc::default() }
    }

    /// The execute thread.
    pub(super) fn run(self, blocks: &Receiver<Vec<Entry>>, applied: &SyncSender<Input>) {
        while let Ok(entries) = blocks.recv() {
            let Some(height) = entries.last().map(|entry| entry.index) else { continue };
            if !self.execute(&entries) {
                return;
            }
            self.waiting.fetch_sub(entries.len(), Ordering::Release);
            if applied.send(Input::Applied { height }).is_err() {
                return;
            }
        }
    }

    /// Gives blocks to the execute thread.
    pub(super) fn hand_over(&self, blocks: &Sender<Vec<Entry>>, entries: Vec<Entry>) {
        self.waiting.fetch_add(entries.len(), Ordering::Relaxed);
        // The other end is only gone when the node has failed already.
        let _stopping = blocks.send(entries);
    }

    /// The block time at which a chaincode has something to do next, [`u64::MAX`] if never.
    pub(super) fn deadline(&self) -> u64 {
        self.deadline.load(Ordering::Relaxed)
    }

    /// Has the execute thread nothing to do? Whoever gives it blocks may execute the next ones itself then.
    pub(super) fn is_idle(&self) -> bool {
        self.waiting.load(Ordering::Acquire) == 0
    }

    /// Executes blocks. False if the node cannot go on.
    pub(super) fn execute(&self, entries: &[Entry]) -> bool {
        for entry in entries {
            if let Err(fault) = self.shared.execute(entry) {
                (self.shared.fatal)(fault);
                return false;
            }
            self.deadline.store(self.shared.ledger.next_deadline().unwrap_or(u64::MAX), Ordering::Relaxed);
        }
        if self.shared.waiters.is_empty() {
            self.shared.awake.rest();
        }
        true
    }
}

/// What the order thread may execute itself.
#[derive(Default)]
pub(super) struct InPlace {
    /// Times that it may not, since it took too long.
    not_before: u32,
}

impl InPlace {
    /// Are these blocks to be executed in place, as far as they themselves and those before them tell?
    pub(super) fn allows(&mut self, entries: &[Entry]) -> bool {
        let allows = self.not_before == 0;
        self.not_before = self.not_before.saturating_sub(1);
        allows && entries.iter().map(|entry| entry.data.len()).sum::<usize>() <= IN_PLACE_BYTES_MAX
    }

    /// Executing them took so long.
    pub(super) fn took(&mut self, time: Duration) {
        if time > IN_PLACE_TIME_MAX {
            self.not_before = HANDED_OVER_AFTERWARDS;
        }
    }
}

impl Shared {
    /// Executes one committed block and tells everybody whom it concerns.
    ///
    /// # Errors
    /// As [`ledger::Ledger::apply`]: the node must stop then.
    pub(crate) fn execute(&self, entry: &Entry) -> Result<Arc<Outcome>, Rejection> {
        let outcome = Arc::new(self.ledger.apply(entry)?);
        self.clock.observe(outcome.header.time);
        self.waiters.resolve(&outcome, &self.ledger);
        self.directory.observe(&outcome, &self.ledger);
        self.witness.observe(&outcome);
        self.blocks.publish(Arc::clone(&outcome));
        self.executed.count(&outcome);
        Ok(outcome)
    }
}

/// Transactions executed since the node started, by number of the verdict's code.
#[derive(Default)]
pub(crate) struct Executed {
    counts: Mutex<BTreeMap<u32, u64>>,
}

impl Executed {
    fn count(&self, outcome: &Outcome) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        for result in &outcome.results {
            *counts.entry(result.code).or_default() += 1;
        }
    }

    /// The numbers.
    pub(crate) fn counts(&self) -> BTreeMap<u32, u64> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger::entry::EntryKind;

    fn blocks(count: usize, bytes: usize) -> Vec<Entry> {
        let entry = |index| Entry { index, term: 1, kind: EntryKind::Normal, data: vec![0; bytes].into() };
        (1..).map(entry).take(count).collect()
    }

    #[test]
    fn a_slow_chaincode_leaves_the_next_blocks_to_the_other_thread() {
        let mut in_place = InPlace::default();
        assert!(in_place.allows(&blocks(1, 400)));
        in_place.took(IN_PLACE_TIME_MAX);
        assert!(in_place.allows(&blocks(1, 400)), "that was quick enough");
        in_place.took(IN_PLACE_TIME_MAX * 2);
        for left in (0..HANDED_OVER_AFTERWARDS).rev() {
            assert!(!in_place.allows(&blocks(1, 400)), "{left} left");
        }
        assert!(in_place.allows(&blocks(1, 400)));
    }

    #[test]
    fn much_is_not_executed_in_place() {
        let mut in_place = InPlace::default();
        assert!(in_place.allows(&blocks(2, IN_PLACE_BYTES_MAX / 2)));
        assert!(!in_place.allows(&blocks(1, IN_PLACE_BYTES_MAX + 1)));
        assert!(!in_place.allows(&blocks(3, IN_PLACE_BYTES_MAX / 2)));
    }
}
