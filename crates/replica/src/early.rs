//! Which calls a node tells its readers before they are ordered, and how often others may make it look at one.
//!
//! An emergency stop reaches a robot this way although the network cannot order anything. The node that takes it in passes it on to
//! all others. Each of them checks it as if it came from a user of its own, so a node that lies wins nothing by passing on.

use crate::replica::Now;
use ledger::Ledger;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_storage::result::Event;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

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
    /// The calls that each node has passed on in the current second.
    passed_on: BTreeMap<u64, Passed>,
}

#[derive(Clone, Copy, Default)]
struct Passed {
    second: u64,
    calls: u32,
}

impl Early {
    /// Takes a call that a user of this node has submitted. Answers what readers are to be told, if it is such a call.
    pub fn submitted(&self, ledger: &Ledger, transaction: &Transaction, now: Now) -> Option<Arc<Foreseen>> {
        let events = ledger.foresee(transaction, now.clock)?;
        self.is_first(transaction.id()).then(|| Arc::new(Foreseen { transaction: transaction.clone(), events }))
    }

    /// Takes a call that another node passes on; as [`Early::submitted`]. Nothing, if that node passes on too many.
    pub fn passed_on(&self, ledger: &Ledger, from: u64, transaction: &Transaction, now: Now) -> Option<Arc<Foreseen>> {
        if !ledger.is_told_early(transaction) || self.knows(transaction.id()) || !self.may_pass_on(from, now.elapsed) {
            return None;
        }
        self.submitted(ledger, transaction, now)
    }

    fn knows(&self, id: Hash) -> bool {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).told.contains(&id)
    }

    fn is_first(&self, id: Hash) -> bool {
        let told = &mut self.known.lock().unwrap_or_else(PoisonError::into_inner).told;
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
        let passed_on = &mut self.known.lock().unwrap_or_else(PoisonError::into_inner).passed_on;
        // Who passes on must be a member now, so there are few.
        passed_on.retain(|_, passed| passed.second == second);
        let passed = passed_on.entry(from).or_insert(Passed { second, calls: 0 });
        passed.calls += 1;
        passed.calls <= PASSED_ON_MAX
    }
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
        let known = early.known.lock().unwrap_or_else(PoisonError::into_inner);
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
