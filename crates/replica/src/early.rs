//! Which calls a node tells its readers before they are ordered, and how often others may make it look at one.
//!
//! An emergency stop reaches a robot this way although the network cannot order anything. The node that takes it in passes it on to
//! all others. Each of them checks it as if it came from a user of its own, so a node that lies wins nothing by passing on. Each
//! keeps it until it has a verdict or is over, and gives it to the leader.

mod open;

use crate::replica::Now;
use bytes::Bytes;
use ledger::Ledger;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_storage::result::Event;
use open::{OPEN_BYTES_MAX, Open};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Calls that one node may pass on in a second. Each costs a look, as a submission does.
const PASSED_ON_MAX: u32 = 32;
/// Calls that are remembered, so that readers hear of each once.
const REMEMBERED_MAX: usize = 4096;
/// Microseconds.
const SECOND: u64 = 1_000_000;

/// A call that readers hear of before it is ordered.
#[derive(Clone, Debug, PartialEq)]
pub struct Foreseen {
    /// The signed call.
    pub transaction: Transaction,
    /// The events that it would have, as this node's state is.
    pub events: Vec<Event>,
}

/// The calls that this node has told of.
#[derive(Default)]
pub struct Early {
    known: Mutex<Known>,
}

#[derive(Default)]
struct Known {
    told: VecDeque<Hash>,
    open: Open,
    /// The calls that each node has passed on in the current second.
    passed_on: BTreeMap<u64, Passed>,
}

#[derive(Clone, Copy, Default)]
struct Passed {
    second: u64,
    calls: u32,
}

impl Early {
    /// Most bytes that are saved.
    pub const SAVED_BYTES_MAX: usize = OPEN_BYTES_MAX;

    /// Takes a call that a user of this node has submitted. Answers what readers are to be told, if it is such a call.
    pub fn submitted(&self, ledger: &Ledger, transaction: &Transaction, now: Now) -> Option<Arc<Foreseen>> {
        let events = ledger.foresee(transaction, now.clock)?;
        if !self.is_first(transaction.id()) {
            return None;
        }
        self.lock().open.keep(transaction, &organisation(ledger, transaction), now.elapsed);
        Some(Arc::new(Foreseen { transaction: transaction.clone(), events }))
    }

    /// The calls that have no verdict yet, for a reader that begins to listen or has missed some.
    pub fn open(&self, ledger: &Ledger, now: Now) -> Vec<Arc<Foreseen>> {
        let calls = self.lock().open.calls().into_iter();
        let foreseen = calls.filter_map(|transaction| {
            let events = ledger.foresee(&transaction, now.clock)?;
            Some(Arc::new(Foreseen { transaction, events }))
        });
        foreseen.collect()
    }

    /// The calls that have no verdict yet, as far as this node knows.
    pub fn calls(&self) -> Vec<Transaction> {
        self.lock().open.calls()
    }

    /// Forgets calls that have a verdict or are over. Answers with those to be passed on, and given to this leader, now, whatever their
    /// verdict will be. To be called often.
    pub fn tend(&self, ledger: &Ledger, leader: Option<u64>, now: Now) -> Vec<Bytes> {
        self.lock().open.tend(ledger, leader, now.elapsed)
    }

    /// The bytes to be saved, at most [`Early::SAVED_BYTES_MAX`] bytes, if that has changed since it was asked for last.
    pub fn changed(&self) -> Option<Vec<u8>> {
        self.lock().open.changed()
    }

    /// Keeps what was saved before the node started.
    ///
    /// # Errors
    /// [`Code::Corrupt`](ledger_base::rejection::Code::Corrupt).
    pub fn restore(&self, ledger: &Ledger, saved: &[u8]) -> Result<(), Rejection> {
        self.lock().open.restore(saved, |transaction| organisation(ledger, transaction))?;
        for call in self.calls() {
            self.is_first(call.id());
        }
        Ok(())
    }

    /// Takes a call that another node passes on; as [`Early::submitted`]. Nothing, if that node passes on too many.
    pub fn passed_on(&self, ledger: &Ledger, from: u64, transaction: &Transaction, now: Now) -> Option<Arc<Foreseen>> {
        if !ledger.is_told_early(transaction) || self.knows(transaction.id()) || !self.may_pass_on(from, now.elapsed) {
            return None;
        }
        self.submitted(ledger, transaction, now)
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn knows(&self, id: Hash) -> bool {
        self.lock().told.contains(&id)
    }

    fn is_first(&self, id: Hash) -> bool {
        let mut known = self.lock();
        let told = &mut known.told;
        if told.contains(&id) {
            return false;
        }
        if told.len() == REMEMBERED_MAX {
            told.pop_front();
        }
        told.push_back(id);
        true
    }

    fn may_pass_on(&self, from: u64, elapsed: u64) -> bool {
        let second = elapsed / SECOND;
        let mut known = self.lock();
        let passed_on = &mut known.passed_on;
        // Who passes on must be a member now, so there are few.
        passed_on.retain(|_, passed| passed.second == second);
        let passed = passed_on.entry(from).or_insert(Passed { second, calls: 0 });
        passed.calls += 1;
        passed.calls <= PASSED_ON_MAX
    }
}

/// The organisation of the signer; empty if the ledger does not know its certificate yet.
fn organisation(ledger: &Ledger, transaction: &Transaction) -> String {
    let name = ledger.creator_name(&transaction.creator()).unwrap_or_default();
    name.split_once('/').map(|(organisation, _)| organisation.to_owned()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(number: u32) -> Hash {
        Hash::of(&[&number.to_be_bytes()])
    }

    #[test]
    fn readers_hear_of_a_call_once() {
        let early = Early::default();
        assert!(early.is_first(id(1)) && early.is_first(id(2)));
        assert!(early.knows(id(1)) && !early.is_first(id(1)), "whoever passes it on again");
    }

    #[test]
    fn what_is_remembered_has_a_bound() {
        let early = Early::default();
        for number in 0..u32::try_from(2 * REMEMBERED_MAX).unwrap_or(u32::MAX) {
            assert!(early.is_first(id(number)));
        }
        let known = early.lock();
        assert_eq!(known.told.len(), REMEMBERED_MAX);
    }

    #[test]
    fn a_node_that_passes_on_too_much_is_not_heard_for_the_rest_of_the_second_and_takes_nothing_from_others() {
        let early = Early::default();
        let heard = |from, elapsed| (0..1000).filter(|_| early.may_pass_on(from, elapsed)).count();
        assert_eq!(heard(2, SECOND), PASSED_ON_MAX as usize);
        assert_eq!(heard(2, 2 * SECOND - 1), 0);
        assert_eq!(heard(3, 2 * SECOND - 1), PASSED_ON_MAX as usize, "each has its own");
        assert_eq!(heard(2, 2 * SECOND), PASSED_ON_MAX as usize, "the next second");
    }
}
