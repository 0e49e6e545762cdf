//! Large transactions that this node has read, between admission and execution. The block has the same bytes: to compare a
//! megabyte takes a tenth of hashing it, and execution needs two hashes of each transaction.

use crate::transaction::Transaction;
use bytes::Bytes;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Smaller ones are hashed again.
const LARGE_BYTES_MIN: usize = 64 * 1024;
/// Most transactions that are kept; the newest.
const KEPT_MAX: usize = 16;
/// Most bytes of them.
const KEPT_BYTES_MAX: usize = 16 * 1024 * 1024;

/// The newest of them.
#[derive(Default)]
pub(crate) struct Large(Mutex<VecDeque<Transaction>>);

impl Large {
    /// It was admitted.
    pub(crate) fn insert(&self, transaction: &Transaction) {
        if transaction.encoded().len() < LARGE_BYTES_MIN {
            return;
        }
        let mut kept = self.kept();
        if kept.contains(transaction) {
            return;
        }
        kept.push_back(transaction.clone());
        while kept.len() > KEPT_MAX || bytes(&kept) > KEPT_BYTES_MAX {
            kept.pop_front();
        }
    }

    /// The one with exactly these bytes, if there is one. It is forgotten with the answer.
    pub(crate) fn take(&self, encoded: &Bytes) -> Option<Transaction> {
        if encoded.len() < LARGE_BYTES_MIN {
            return None;
        }
        let mut kept = self.kept();
        let position = kept.iter().position(|transaction| transaction.encoded() == encoded)?;
        kept.remove(position)
    }

    fn kept(&self) -> MutexGuard<'_, VecDeque<Transaction>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn bytes(kept: &VecDeque<Transaction>) -> usize {
    kept.iter().map(|transaction| transaction.encoded().len()).sum()
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::transaction::Body;
    use ledger_identity::key::{KeyKind, SigningKey};
    use ring::rand::SystemRandom;

    fn transaction(number: u64, bytes: usize) -> Transaction {
        let key = SigningKey::generate(KeyKind::Ed25519, &SystemRandom::new()).unwrap();
        let body = Body {
            network: vec![1; 32].into(),
            creator: vec![2; 32].into(),
            nonce: vec![3; 16].into(),
            not_after: number,
            chaincode: "abac".into(),
            function: "set".into(),
            args: vec![vec![0; bytes].into()],
            known_block: None,
        };
        Transaction::sign(&body, &key).unwrap()
    }

    #[test]
    fn a_large_transaction_is_found_by_its_bytes_once_and_no_other_one_is() {
        let (large, kept, other) = (Large::default(), transaction(1, LARGE_BYTES_MIN), transaction(2, LARGE_BYTES_MIN));
        // It may be judged twice.
        large.insert(&kept);
        large.insert(&kept);
        assert_eq!(large.take(other.encoded()), None);
        let copy = Bytes::copy_from_slice(kept.encoded());
        let found = large.take(&copy).unwrap();
        assert_eq!((found.id(), found.leaf()), (kept.id(), crate::block::leaf(&copy)));
        assert_eq!(large.take(&copy), None);
    }

    #[test]
    fn few_are_kept_and_small_ones_not_at_all() {
        let large = Large::default();
        let small = transaction(0, 100);
        large.insert(&small);
        assert_eq!(large.take(small.encoded()), None);
        let many: Vec<_> = (0..).map(|number| transaction(number, 2 * LARGE_BYTES_MIN)).take(KEPT_MAX + 1).collect();
        many.iter().for_each(|transaction| large.insert(transaction));
        let found = many.iter().filter(|transaction| large.take(transaction.encoded()).is_some());
        assert_eq!(found.count(), KEPT_MAX, "the oldest went");
        let huge: Vec<_> = (0..).map(|number| transaction(number, KEPT_BYTES_MAX / 5)).take(6).collect();
        huge.iter().for_each(|transaction| large.insert(transaction));
        assert!(bytes(&large.kept()) <= KEPT_BYTES_MAX && large.take(huge[5].encoded()).is_some());
    }
}
