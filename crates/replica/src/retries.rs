//! Repetitions that this node's state refuses, and that are ordered though, as only the chain can tell what became of
//! the first copy. A caller without rights could have everything ordered in this way, so there are few of them for each
//! identity.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Transactions of one identity that are ordered so in a second.
const TRANSACTIONS_MAX: usize = 32;
/// Bytes of them.
const BYTES_MAX: usize = 64 * 1024;
/// Identities remembered before those of earlier seconds are forgotten.
const IDENTITIES_MAX: usize = 1024;
/// Microseconds.
const SECOND: u64 = 1_000_000;

/// The number of them that identities have used of the current second.
#[derive(Default)]
pub struct Retries {
    used: Mutex<HashMap<String, Used>>,
}

#[derive(Clone, Copy, Default)]
struct Used {
    second: u64,
    transactions: usize,
    bytes: usize,
}

impl Retries {
    /// May one more of so many bytes be ordered for an identity, at the node's time in microseconds? Then it is counted.
    pub fn allow(&self, who: &str, bytes: usize, now: u64) -> bool {
        let second = now / SECOND;
        let mut all = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        if all.len() >= IDENTITIES_MAX {
            all.retain(|_, used| used.second == second);
        }
        let mut used = all.get(who).copied().filter(|used| used.second == second).unwrap_or_default();
        used = Used { second, transactions: used.transactions + 1, bytes: used.bytes.saturating_add(bytes) };
        let allowed = used.transactions <= TRANSACTIONS_MAX && used.bytes <= BYTES_MAX;
        if allowed {
            all.insert(who.to_owned(), used);
        }
        allowed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn allowed(retries: &Retries, who: &str, bytes: usize, now: u64) -> usize {
        (0..1000).filter(|_| retries.allow(who, bytes, now)).count()
    }

    #[test]
    fn an_identity_has_few_refused_repetitions_ordered_in_a_second() {
        let retries = Retries::default();
        assert_eq!(allowed(&retries, "Org1/Farhad", 300, SECOND), TRANSACTIONS_MAX);
        assert_eq!(allowed(&retries, "Org1/Salma", 300, SECOND), TRANSACTIONS_MAX, "each has its own");
        assert_eq!(allowed(&retries, "Org1/Farhad", 300, 2 * SECOND - 1), 0);
        assert_eq!(allowed(&retries, "Org1/Farhad", 300, 2 * SECOND), TRANSACTIONS_MAX, "the next second");
    }

    #[test]
    fn they_are_small() {
        let retries = Retries::default();
        assert_eq!(allowed(&retries, "Org1/Farhad", BYTES_MAX + 1, SECOND), 0);
        assert_eq!(allowed(&retries, "Org1/Farhad", BYTES_MAX / 2, SECOND), 2);
    }

    #[test]
    fn who_was_not_heard_of_for_a_second_is_forgotten() {
        let retries = Retries::default();
        for number in 0..10_000u64 {
            assert!(retries.allow(&number.to_string(), 1, number * SECOND / 100));
        }
        assert!(retries.used.lock().unwrap_or_else(PoisonError::into_inner).len() <= IDENTITIES_MAX);
    }
}
