//! The execute thread: applies committed blocks, wakes subscribers, answers clients.

use super::Shared;
use ledger::entry::Entry;
use ledger::{Outcome, Rejection};
use ledger_raft::Input;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};

/// The execute thread.
pub(super) struct Execute {
    shared: Arc<Shared>,
    deadline: Arc<AtomicU64>,
    applied: SyncSender<Input>,
}

impl Execute {
    pub(super) fn new(shared: Arc<Shared>, deadline: Arc<AtomicU64>, applied: SyncSender<Input>) -> Self {
        Self { shared, deadline, applied }
    }

    pub(super) fn run(self, blocks: &Receiver<Vec<Entry>>) {
        while let Ok(entries) = blocks.recv() {
            let Some(height) = entries.last().map(|entry| entry.index) else { continue };
            for entry in &entries {
                if let Err(fault) = self.execute(entry) {
                    (self.shared.fatal)(fault);
                    return;
                }
            }
            if self.shared.waiters.is_empty() {
                self.shared.awake.rest();
            }
            if self.applied.send(Input::Applied { height }).is_err() {
                return;
            }
        }
    }

    fn execute(&self, entry: &Entry) -> Result<(), Rejection> {
        self.shared.execute(entry)?;
        self.deadline.store(self.shared.ledger.next_deadline().unwrap_or(u64::MAX), Ordering::Relaxed);
        Ok(())
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
