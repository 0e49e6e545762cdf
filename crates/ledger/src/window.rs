//! Which ids were executed a short time ago: what makes a transaction count once.

use ledger_base::hash::Hash;
use ledger_storage::results::{Place, SHORT_ID_BYTES};
use std::collections::{BTreeMap, HashMap};

/// Unit in which ids are forgotten together, microseconds.
const SECOND: u64 = 1_000_000;

/// The ids of executed transactions until their `not_after`, in block time.
///
/// Whether an id counts as executed is decided by the chain alone: the caller asks only for ids whose `not_after` block
/// time has not passed, and those are never forgotten. Everything else is refused as expired in any case. A transaction
/// always has the same `not_after`, as its id covers it, so an id is looked for in one second only, and seconds are
/// forgotten as a whole. About 60 bytes an id: two seconds of commands, and at most 120 s of whatever clients let live so
/// long.
#[derive(Debug, Default)]
pub(crate) struct Window {
    seconds: BTreeMap<u64, HashMap<u128, Place>>,
    /// Everything before this second is forgotten.
    first: u64,
}

impl Window {
    /// Where the transaction was executed.
    pub(crate) fn find(&self, id: &Hash, not_after: u64) -> Option<Place> {
        self.seconds.get(&(not_after / SECOND))?.get(&short(id)).copied()
    }

    /// Where the transaction was executed, if it is not known until when it is remembered.
    pub(crate) fn find_any(&self, id: &Hash) -> Option<Place> {
        let short = short(id);
        self.seconds.values().find_map(|ids| ids.get(&short)).copied()
    }

    /// Are executed transactions that live until then still remembered?
    pub(crate) fn covers(&self, not_after: u64) -> bool {
        not_after / SECOND >= self.first
    }

    /// Remembers an executed transaction.
    pub(crate) fn insert(&mut self, id: &Hash, not_after: u64, place: Place) {
        self.seconds.entry(not_after / SECOND).or_default().insert(short(id), place);
    }

    /// Forgets what block time has passed.
    pub(crate) fn forget_before(&mut self, time: u64) {
        let second = time / SECOND;
        self.first = self.first.max(second);
        while let Some(oldest) = self.seconds.first_entry().filter(|oldest| *oldest.key() < second) {
            oldest.remove();
        }
    }
}

/// Half of the id is enough: two transactions that agree in it cost 2^64 attempts. Then their creator's second one
/// counts as a duplicate, on every node alike.
fn short(Hash(id): &Hash) -> u128 {
    id.iter().take(SHORT_ID_BYTES).fold(0, |number, byte| number << 8 | u128::from(*byte))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn ids_are_remembered_until_block_time_has_passed_them_and_no_longer() {
        let mut window = Window::default();
        let id = |number: u64| Hash::of(&[&number.to_be_bytes()]);
        for number in 0..1000u64 {
            let place = Place { height: number, position: 7 };
            window.insert(&id(number), number * SECOND / 10, place);
        }
        window.forget_before(50 * SECOND);
        for number in 500..1000 {
            let place = Some(Place { height: number, position: 7 });
            assert_eq!(window.find(&id(number), number * SECOND / 10), place);
            assert_eq!(window.find_any(&id(number)), place);
        }
        assert!((0..500).all(|number| window.find_any(&id(number)).is_none()));
        assert_eq!(window.seconds.len(), 50);
        assert_eq!(window.find(&id(999), 999 * SECOND), None, "another not_after is another transaction");
        window.forget_before(u64::MAX);
        assert!(window.seconds.first_key_value().is_none());
    }

    #[test]
    fn the_first_half_of_the_id_counts() {
        let mut first = [0; 32];
        *first.first_mut().unwrap() = 1;
        assert_ne!(short(&Hash(first)), short(&Hash([0; 32])));
    }
}
