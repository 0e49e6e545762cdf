//! Execution: applies committed blocks, wakes subscribers, answers clients.

use super::Shared;
use super::inbox::Inbox;
use crate::housekeeping::PENDING_BYTES_MAX;
use ledger::Outcome;
use ledger_raft::Input;
use ledger_rejection::Rejection;
use ledger_storage::entry::Entry;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Bytes of blocks that are executed in place at most: some commands.
const IN_PLACE_BYTES_MAX: usize = 4096;
/// Time that executing in place may take. Heartbeats and writes must not wait for a slow chaincode.
const IN_PLACE_TIME_MAX: Duration = Duration::from_millis(1);
/// Times that nothing is executed in place after it took longer.
const HANDED_OVER_AFTERWARDS: u32 = 1000;

/// Bytes of blocks that are verified together at least, if so many wait: about as many signatures as it takes until more
/// cost no less.
const TURN_BYTES: usize = 16 * 1024;

/// Executes committed blocks, on one thread at a time.
#[derive(Clone)]
pub(super) struct Execute {
    shared: Arc<Shared>,
    /// As of the newest block executed.
    deadline: Arc<AtomicU64>,
    given: Given,
}

impl Execute {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        let deadline = Arc::new(AtomicU64::new(shared.ledger.next_deadline().unwrap_or(u64::MAX)));
        Self { shared, deadline, given: Given::default() }
    }

    /// The execute thread.
    pub(super) fn run(self, blocks: &Inbox<Entry>, applied: &Inbox<Input>) {
        loop {
            let entries = blocks.next();
            if entries.is_empty() {
                return;
            }
            for entries in in_turns(&entries) {
                self.shared.ledger.verify_blocks(entries);
                if !self.execute(entries) {
                    return;
                }
                self.given.remove(entries.len());
                let at = self.shared.clock.now();
                applied.put(entries.last().map(|entry| Input::Applied { height: entry.index, at }));
            }
        }
    }

    /// Gives blocks to the execute thread.
    pub(super) fn hand_over(&self, blocks: &Inbox<Entry>, entries: Vec<Entry>) {
        self.given.add(entries.len());
        blocks.put(entries);
    }

    /// The block time at which a chaincode has something to do next, [`u64::MAX`] if never.
    pub(super) fn deadline(&self) -> u64 {
        self.deadline.load(Ordering::Relaxed)
    }

    /// Has the execute thread nothing to do? Whoever gives it blocks may execute the next ones itself then.
    pub(super) fn is_idle(&self) -> bool {
        self.given.is_empty()
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
        if self.shared.ledger.pending_bytes() > PENDING_BYTES_MAX {
            self.shared.bells.storing.ring();
        }
        true
    }
}

/// Counts the blocks that were given to the execute thread and that it has not executed. Only whoever gives them adds to
/// it, so when it finds it empty nobody else executes, and everything before its next block is executed.
#[derive(Clone, Default)]
struct Given(Arc<AtomicUsize>);

impl Given {
    fn add(&self, blocks: usize) {
        self.0.fetch_add(blocks, Ordering::Relaxed);
    }

    /// So many are executed. Whoever sees it sees what they wrote.
    fn remove(&self, blocks: usize) {
        self.0.fetch_sub(blocks, Ordering::Release);
    }

    fn is_empty(&self) -> bool {
        self.0.load(Ordering::Acquire) == 0
    }
}

/// Blocks in groups that are verified together, and told to be executed together.
fn in_turns(entries: &[Entry]) -> impl Iterator<Item = &[Entry]> {
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

/// What else is going on when blocks are to be executed.
pub(super) struct Circumstances {
    /// Somebody waits for what the order thread does next: a leader, for what a voter that follows writes.
    pub(super) awaited: bool,
    /// Inputs wait: they are to be ordered while the other thread executes.
    pub(super) inputs_wait: bool,
    /// The execute thread has executed everything it was given.
    pub(super) other_is_idle: bool,
}

/// What the order thread may execute itself.
#[derive(Default)]
pub(super) struct InPlace {
    /// Times that it may not, since it took too long.
    not_before: u32,
}

impl InPlace {
    /// Are these blocks to be executed in place?
    pub(super) fn allows(&mut self, entries: &[Entry], now: &Circumstances) -> bool {
        if now.awaited {
            return false;
        }
        let quick = self.not_before == 0;
        self.not_before = self.not_before.saturating_sub(1);
        quick
            && !now.inputs_wait
            && now.other_is_idle
            && entries.iter().map(|entry| entry.data.len()).sum::<usize>() <= IN_PLACE_BYTES_MAX
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
    use ledger_storage::entry::EntryKind;

    fn blocks(count: usize, bytes: usize) -> Vec<Entry> {
        let entry = |index| Entry { index, term: 1, kind: EntryKind::Normal, data: vec![0; bytes].into() };
        (1..).map(entry).take(count).collect()
    }

    /// Nothing speaks against executing in place.
    const QUIET: Circumstances = Circumstances { awaited: false, inputs_wait: false, other_is_idle: true };

    #[test]
    fn nothing_is_executed_in_place_while_the_other_thread_executes() {
        let given = Given::default();
        let at_the_other_thread = given.clone();
        assert!(given.is_empty());
        given.add(3);
        at_the_other_thread.remove(2);
        assert!(!given.is_empty(), "one is not executed yet");
        at_the_other_thread.remove(1);
        assert!(given.is_empty());
        let busy = Circumstances { other_is_idle: false, ..QUIET };
        assert!(!InPlace::default().allows(&blocks(1, 400), &busy));
    }

    #[test]
    fn a_voter_that_follows_writes_and_does_not_execute_in_place() {
        let awaited = Circumstances { awaited: true, ..QUIET };
        assert!(!InPlace::default().allows(&blocks(1, 400), &awaited));
    }

    #[test]
    fn what_waits_is_ordered_before_anything_is_executed_in_place() {
        let inputs_wait = Circumstances { inputs_wait: true, ..QUIET };
        assert!(!InPlace::default().allows(&blocks(1, 400), &inputs_wait));
    }

    #[test]
    fn a_slow_chaincode_leaves_the_next_blocks_to_the_other_thread() {
        let mut in_place = InPlace::default();
        assert!(in_place.allows(&blocks(1, 400), &QUIET));
        in_place.took(IN_PLACE_TIME_MAX);
        assert!(in_place.allows(&blocks(1, 400), &QUIET), "that was quick enough");
        in_place.took(IN_PLACE_TIME_MAX * 2);
        for left in (0..HANDED_OVER_AFTERWARDS).rev() {
            assert!(!in_place.allows(&blocks(1, 400), &QUIET), "{left} left");
        }
        assert!(in_place.allows(&blocks(1, 400), &QUIET));
    }

    #[test]
    fn blocks_are_executed_in_order_and_in_groups_worth_verifying_together() {
        let lengths = |blocks: &[Entry]| in_turns(blocks).map(<[Entry]>::len).collect::<Vec<_>>();
        assert!(lengths(&[]).is_empty());
        assert_eq!(lengths(&blocks(1, 10 * TURN_BYTES)), [1]);
        assert_eq!(lengths(&blocks(3, TURN_BYTES)), [1, 1, 1], "each is worth it alone");
        assert_eq!(lengths(&blocks(10, TURN_BYTES / 4)), [4, 4, 2]);
        let many = blocks(1000, 300);
        assert_eq!(in_turns(&many).flatten().collect::<Vec<_>>(), many.iter().collect::<Vec<_>>());
    }

    #[test]
    fn much_is_not_executed_in_place() {
        let mut in_place = InPlace::default();
        assert!(in_place.allows(&blocks(2, IN_PLACE_BYTES_MAX / 2), &QUIET));
        assert!(!in_place.allows(&blocks(1, IN_PLACE_BYTES_MAX + 1), &QUIET));
        assert!(!in_place.allows(&blocks(3, IN_PLACE_BYTES_MAX / 2), &QUIET));
    }
}
