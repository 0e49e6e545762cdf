//! The waiting transactions of one organisation, fair between its creators.
//!
//! Everything gets a tag when it comes: where its creator's previous transaction ends in virtual time, but not before what is
//! taken now. Tags give the order. So the transactions of one creator stay in their order, and those who send little pass
//! those who send much.

use crate::queue::Waiting;
use bytes::Bytes;
use ledger::transaction::claimed_creator;
use ledger_base::hash::Hash;
use std::collections::{BTreeMap, btree_map};

/// The cost of executing a transaction beside its bytes, in bytes that cost about as much.
const TRANSACTION_COST_BYTES: usize = 256;

/// The waiting transactions of one organisation.
#[derive(Debug, Default)]
pub(super) struct Backlog {
    /// In the order in which they will be taken.
    items: BTreeMap<Rank, Waiting>,
    /// Creators of what waits.
    creators: BTreeMap<Hash, Own>,
    /// Virtual time within the organisation: the tag of what was taken last.
    reached: u64,
    cost: u64,
}

/// A place in the order: by tag, then as they came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Rank {
    tag: u64,
    pub(super) number: u64,
}

/// The waiting transactions of one creator.
#[derive(Debug, Default)]
struct Own {
    transactions: usize,
    /// Where they end in virtual time.
    end: u64,
}

impl Backlog {
    pub(super) fn push(&mut self, creator: Hash, number: u64, waiting: Waiting) {
        let (tag, cost) = (self.tag_of(&creator), cost(&waiting.transaction) as u64);
        let own = self.creators.entry(creator).or_default();
        own.transactions += 1;
        own.end = tag.saturating_add(cost);
        self.cost += cost;
        self.items.insert(Rank { tag, number }, waiting);
    }

    /// The tag of the next transaction of a creator.
    fn tag_of(&self, creator: &Hash) -> u64 {
        self.creators.get(creator).map_or(self.reached, |own| own.end.max(self.reached))
    }

    pub(super) fn first(&self) -> Option<Rank> {
        self.items.first_key_value().map(|(rank, _)| *rank)
    }

    pub(super) fn last(&self) -> Option<Rank> {
        self.items.last_key_value().map(|(rank, _)| *rank)
    }

    /// The last, if it comes after a new one of this creator.
    pub(super) fn last_behind(&self, creator: &Hash) -> Option<Rank> {
        self.last().filter(|last| last.tag > self.tag_of(creator))
    }

    /// Virtual time has come to this one, which is taken.
    pub(super) fn reached(&mut self, rank: &Rank) {
        self.reached = self.reached.max(rank.tag);
    }

    pub(super) fn in_order(&self) -> Ordered<'_> {
        Ordered(self.items.iter())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// The cost of everything that waits.
    pub(super) fn cost(&self) -> u64 {
        self.cost
    }

    /// The cost of this one.
    pub(super) fn cost_of(&self, rank: &Rank) -> u64 {
        self.items.get(rank).map_or(0, |waiting| cost(&waiting.transaction) as u64)
    }

    pub(super) fn remove(&mut self, rank: Rank) -> Option<Waiting> {
        let waiting = self.items.remove(&rank)?;
        let (creator, cost) = (creator(&waiting.transaction), cost(&waiting.transaction) as u64);
        self.cost -= cost;
        if let Some(own) = self.creators.get_mut(&creator) {
            own.transactions -= 1;
            if own.end == rank.tag.saturating_add(cost) {
                // It was the creator's last: the next one follows what is left.
                own.end = rank.tag;
            }
            if own.transactions == 0 {
                self.creators.remove(&creator);
            }
        }
        Some(waiting)
    }
}

/// The waiting transactions of one organisation, in order.
pub(super) struct Ordered<'a>(btree_map::Iter<'a, Rank, Waiting>);

impl<'a> Iterator for Ordered<'a> {
    type Item = (Rank, &'a Waiting);

    fn next(&mut self) -> Option<Self::Item> {
        self.0.next().map(|(rank, waiting)| (*rank, waiting))
    }
}

/// The cost of ordering and executing a transaction, in bytes that cost as much.
pub(super) fn cost(transaction: &Bytes) -> usize {
    transaction.len() + TRANSACTION_COST_BYTES
}

/// Its creator. Bytes that are no transaction belong to an unknown creator, who is one creator like others.
pub(super) fn creator(transaction: &Bytes) -> Hash {
    claimed_creator(transaction).unwrap_or_default()
}
