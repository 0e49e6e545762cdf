//! Transactions that this client has signed and no node has seen: only of these a node may say that a refusal is final
//! without looking for a copy elsewhere.

use ledger_base::hash::Hash;
use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};

/// Signed transactions remembered until they are submitted; twice as many at most. One that is forgotten counts as
/// one that may have been sent, which is never wrong.
const SIGNED_MAX: usize = 16_384;

/// Ids of signed transactions, in two generations, so that those that are never submitted are forgotten.
#[derive(Default)]
pub(super) struct Fresh(Mutex<Generations>);

#[derive(Default)]
struct Generations {
    young: HashSet<Hash>,
    old: HashSet<Hash>,
}

impl Fresh {
    /// It was signed just now.
    pub(super) fn signed(&self, id: Hash) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if all.young.len() >= SIGNED_MAX {
            all.old = std::mem::take(&mut all.young);
        }
        all.young.insert(id);
    }

    /// It is about to be sent. Was it never before?
    pub(super) fn take(&self, id: &Hash) -> bool {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.young.remove(id) || all.old.remove(id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transaction_is_new_once_and_what_is_forgotten_is_not_new() {
        let fresh = Fresh::default();
        let id = |number: usize| Hash::of(&[&number.to_be_bytes()]);
        assert!(!fresh.take(&id(0)), "somebody else signed it");
        for number in 0..3 * SIGNED_MAX {
            fresh.signed(id(number));
        }
        let last = id(3 * SIGNED_MAX - 1);
        assert!(fresh.take(&last));
        assert!(!fresh.take(&last));
        assert!(!fresh.take(&id(0)));
    }
}
