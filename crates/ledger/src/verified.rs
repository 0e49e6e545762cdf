//! Which signatures this node has verified, so that it verifies each once.

use ledger_base::hash::Hash;
use std::collections::HashSet;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Signatures remembered between admission and execution; twice as many at most.
const VERIFIED_MAX: usize = 32_768;

/// The leaves of transactions (see [`crate::block::leaf`]), which cover their signatures.
#[derive(Default)]
pub(crate) struct Verified(Mutex<Generations>);

/// Two of them, so that it stays small without an order.
#[derive(Default)]
struct Generations {
    young: HashSet<Hash>,
    old: HashSet<Hash>,
}

impl Verified {
    /// Its signature was verified.
    pub(crate) fn insert(&self, leaf: Hash) {
        let mut leaves = self.leaves();
        if leaves.young.len() >= VERIFIED_MAX {
            leaves.old = std::mem::take(&mut leaves.young);
        }
        leaves.young.insert(leaf);
    }

    /// Was its signature verified?
    pub(crate) fn contains(&self, leaf: &Hash) -> bool {
        let leaves = self.leaves();
        leaves.young.contains(leaf) || leaves.old.contains(leaf)
    }

    /// Was its signature verified? It is forgotten with the answer.
    pub(crate) fn take(&self, leaf: &Hash) -> bool {
        let mut leaves = self.leaves();
        leaves.young.remove(leaf) || leaves.old.remove(leaf)
    }

    fn leaves(&self) -> MutexGuard<'_, Generations> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
