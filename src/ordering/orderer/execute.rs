//! Execution of committed blocks, on one of the two threads at a time.

use super::Engines;
use super::inbox::Inbox;
use crate::process::meters::observe;
use crate::storage::housekeeping::PENDING_BYTES_MAX;
use ledger::{Ledger, Outcome};
use ledger_base::invariant;
use ledger_raft::Input;
use ledger_replica::{Observer, in_turns};
use ledger_storage::entry::Entry;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Executes committed blocks.
#[derive(Clone)]
pub(super) struct Execute {
    engines: Arc<Engines>,
    given: Given,
}

impl Execute {
    pub(super) fn new(engines: &Arc<Engines>) -> Self {
        Self { engines: Arc::clone(engines), given: Given::default() }
    }

    /// The execute thread.
    pub(super) fn run(self, blocks: &Inbox<Entry>, applied: &Inbox<Input>) {
        loop {
            let entries = blocks.next();
            if entries.is_empty() {
                return;
            }
            for entries in in_turns(&entries) {
                self.engines.executor.ledger().verify_blocks(entries);
                if !self.execute(entries) {
                    return;
                }
                self.given.remove(entries.len());
                let at = self.engines.clock.now();
                applied.put(entries.last().map(|entry| Input::Applied { height: entry.index, at }));
            }
        }
    }

    /// Gives blocks to the execute thread.
    pub(super) fn hand_over(&self, blocks: &Inbox<Entry>, entries: Vec<Entry>) {
        self.given.add(entries.len());
        blocks.put(entries);
    }

    /// Has the execute thread nothing to do? The thread that gives it blocks may execute the next ones itself then.
    pub(super) fn is_idle(&self) -> bool {
        self.given.is_empty()
    }

    /// Executes blocks. False if the node cannot go on.
    pub(super) fn execute(&self, entries: &[Entry]) -> bool {
        let since = Instant::now();
        let executed = self.engines.executor.execute_all(entries);
        observe(&self.engines.execution, since);
        if let Err(fault) = executed {
            self.engines.failure.fail(fault);
            return false;
        }
        if self.engines.executor.ledger().pending_bytes() > PENDING_BYTES_MAX {
            self.engines.bells.storing.ring();
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

    /// So many are executed. A thread that sees it sees their writes.
    fn remove(&self, blocks: usize) {
        let before = self.0.fetch_sub(blocks, Ordering::Release);
        invariant!(
            before >= blocks,
            "executed blocks were given",
            "{blocks} blocks were executed, {before} were given"
        );
    }

    fn is_empty(&self) -> bool {
        self.0.load(Ordering::Acquire) == 0
    }
}

/// Transactions executed since the node started, by number of the verdict's code.
#[derive(Default)]
pub(crate) struct Executed {
    counts: Mutex<BTreeMap<u32, u64>>,
}

impl Observer for Executed {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        for result in &outcome.results {
            *counts.entry(result.code).or_default() += 1;
        }
    }
}

impl Executed {
    /// The numbers.
    pub(crate) fn counts(&self) -> BTreeMap<u32, u64> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_other_thread_is_idle_once_it_has_executed_everything_it_was_given() {
        let given = Given::default();
        let at_the_other_thread = given.clone();
        assert!(given.is_empty());
        given.add(3);
        at_the_other_thread.remove(2);
        assert!(!given.is_empty(), "one is not executed yet");
        at_the_other_thread.remove(1);
        assert!(given.is_empty());
    }
}
