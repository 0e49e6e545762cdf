//! Calls that wait for their replies: few, and not for ever. Without IO.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use crate::routes::ends::CALLS_MAX;

/// The calls by what their replies are known by.
#[derive(Debug)]
pub(in crate::routes) struct Waiting<K, V> {
    patience: Duration,
    /// With the end of their time.
    calls: BTreeMap<K, (Instant, V)>,
}

impl<K: Ord + Clone, V> Waiting<K, V> {
    pub(in crate::routes) fn new(patience: Duration) -> Self {
        Self { patience, calls: BTreeMap::new() }
    }

    /// Is there no room for another one?
    pub(in crate::routes) fn is_full(&self) -> bool {
        self.calls.len() >= CALLS_MAX
    }

    /// Does none wait?
    pub(in crate::routes) fn is_empty(&self) -> bool {
        self.calls.is_empty()
    }

    /// Lets a call wait from now on.
    pub(in crate::routes) fn insert(&mut self, key: K, call: V, now: Instant) {
        self.calls.insert(key, (now + self.patience, call));
    }

    /// A call, which waits on.
    pub(in crate::routes) fn get_mut(&mut self, key: &K) -> Option<&mut V> {
        self.calls.get_mut(key).map(|(_, call)| call)
    }

    /// A call, which waits no longer.
    pub(in crate::routes) fn take(&mut self, key: &K) -> Option<V> {
        self.calls.remove(key).map(|(_, call)| call)
    }

    /// When the first of them has waited long enough.
    pub(in crate::routes) fn due(&self) -> Option<Instant> {
        self.calls.values().map(|(due, _)| *due).min()
    }

    /// Those that have waited long enough, and wait no longer.
    pub(in crate::routes) fn expire(&mut self, now: Instant) -> Vec<V> {
        let over: Vec<K> = self.calls.iter().filter(|(_, (due, _))| *due <= now).map(|(key, _)| key.clone()).collect();
        over.iter().filter_map(|key| self.take(key)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_waits_for_its_time_and_no_longer() {
        let (mut waiting, start) = (Waiting::new(Duration::from_secs(10)), Instant::now());
        waiting.insert(1, "one", start);
        waiting.insert(2, "two", start + Duration::from_secs(1));
        waiting.insert(3, "three", start + Duration::from_secs(2));
        assert_eq!(waiting.due(), Some(start + Duration::from_secs(10)));
        assert_eq!(waiting.take(&1), Some("one"));
        assert_eq!((waiting.take(&1), waiting.get_mut(&2).copied()), (None, Some("two")));
        assert!(waiting.expire(start + Duration::from_millis(10_999)).is_empty());
        assert_eq!(waiting.expire(start + Duration::from_secs(11)), ["two"]);
        assert_eq!((waiting.take(&2), waiting.take(&3), waiting.due()), (None, Some("three"), None));
    }

    #[test]
    fn only_so_many_wait() {
        let mut waiting = Waiting::new(Duration::from_secs(1));
        for key in 0..CALLS_MAX {
            assert!(!waiting.is_full());
            waiting.insert(key, (), Instant::now());
        }
        assert!(waiting.is_full());
        assert_eq!(waiting.take(&0), Some(()));
        assert!(!waiting.is_full());
    }
}
