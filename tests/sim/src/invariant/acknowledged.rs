//! Acknowledged is durable (design.md §7.1): when a client hears of a verdict, its block is on the disks of a majority
//! of the voters. Entries that a node once called durable are there after every crash.

use super::{Check, Violation};
use ledger::members::Membership;
use ledger_storage::block_store::BlockStore;
use std::collections::{BTreeMap, BTreeSet};

const NAME: &str = "acknowledged is durable";

/// The entries that each node has called durable: the terms of its log from index 1.
#[derive(Default)]
pub struct AcknowledgedIsDurable {
    durable: BTreeMap<u64, Vec<u64>>,
}

impl AcknowledgedIsDurable {
    /// A node's flush has returned.
    pub fn flushed(&mut self, node: u64, store: &BlockStore) {
        let terms = self.durable.entry(node).or_default();
        let last = store.durable_index();
        terms.truncate(last as usize);
        while terms.last().is_some_and(|term| store.term(terms.len() as u64) != Some(*term)) {
            terms.pop();
        }
        while (terms.len() as u64) < last {
            let index = terms.len() as u64 + 1;
            terms.push(store.term(index).unwrap_or(0));
        }
    }

    /// A node has started again, on the disk that it had before.
    ///
    /// # Errors
    /// The disk lacks what the node had called durable.
    pub fn restarted(&mut self, node: u64, store: &BlockStore) -> Check {
        let terms = self.durable.get(&node).map(Vec::as_slice).unwrap_or_default();
        let newest = store.term(store.last_index());
        for (at, term) in terms.iter().enumerate() {
            let index = at as u64 + 1;
            if index < store.first_index() {
                continue;
            }
            // A later write that was not acknowledged may have superseded it, or one before it: that has a higher term.
            if store.term(index).or(newest).is_none_or(|found| found < *term)
                || (index > store.last_index() && newest == Some(*term))
            {
                return Err(Violation::new(
                    NAME,
                    format!("node {node} had entry {index} of term {term} on its disk, and lost it in a crash"),
                ));
            }
        }
        self.flushed(node, store);
        Ok(())
    }

    /// A client hears that its transaction is in this block. `members` are those of the time when the block was
    /// ordered and of now: one set's majority reaches into the next's.
    ///
    /// # Errors
    /// The block is not on the disks of a majority.
    pub fn acknowledged(&self, height: u64, term: u64, members: &[&Membership]) -> Check {
        let holds = |node: &u64| {
            self.durable.get(node).and_then(|terms| terms.get(height as usize - 1)).is_some_and(|found| *found == term)
        };
        let majority = |voters: &BTreeSet<u64>| voters.iter().filter(|node| holds(node)).count() > voters.len() / 2;
        if members
            .iter()
            .any(|members| majority(&members.voters) && (members.outgoing.is_empty() || majority(&members.outgoing)))
        {
            return Ok(());
        }
        let holders: Vec<&u64> = self.durable.keys().filter(|node| holds(node)).collect();
        let what = format!("block {height} of term {term} was acknowledged with only {holders:?} holding it");
        Err(Violation::new(NAME, what))
    }
}
