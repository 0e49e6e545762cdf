//! When which endpoint or participant has something to do next.

use std::collections::{BTreeMap, BTreeSet};

/// Deadlines by key, one for each, in microseconds of the steady clock.
#[derive(Debug)]
pub(crate) struct Timers<K> {
    due: BTreeSet<(u64, K)>,
    /// Invariant: the same pairs as in `due`.
    of: BTreeMap<K, u64>,
}

impl<K> Default for Timers<K> {
    fn default() -> Self {
        Self { due: BTreeSet::new(), of: BTreeMap::new() }
    }
}

impl<K: Ord + Copy> Timers<K> {
    /// Replaces the deadline of a key.
    pub(crate) fn set(&mut self, key: K, deadline: Option<u64>) {
        let before = match deadline {
            Some(at) => self.of.insert(key, at),
            None => self.of.remove(&key),
        };
        if before == deadline {
            return;
        }
        if let Some(at) = before {
            self.due.remove(&(at, key));
        }
        if let Some(at) = deadline {
            self.due.insert((at, key));
        }
    }

    /// The earliest deadline.
    pub(crate) fn next(&self) -> Option<u64> {
        self.due.first().map(|(at, _)| *at)
    }

    /// The keys that are due, the earliest first. They have no deadline after this.
    pub(crate) fn take_due(&mut self, now: u64) -> Vec<K> {
        let mut keys = Vec::new();
        while let Some((at, key)) = self.due.first().copied().filter(|(at, _)| *at <= now) {
            self.due.remove(&(at, key));
            self.of.remove(&key);
            keys.push(key);
        }
        keys
    }

    /// Moves all deadlines into the future.
    pub(crate) fn postpone(&mut self, by: u64) {
        self.due = self.due.iter().map(|(at, key)| (at.saturating_add(by), *key)).collect();
        self.of.values_mut().for_each(|at| *at = at.saturating_add(by));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_has_one_deadline_and_is_due_once() {
        let mut timers = Timers::default();
        timers.set('a', Some(5));
        timers.set('a', Some(7));
        timers.set('b', Some(6));
        timers.set('c', Some(1));
        timers.set('c', None);
        assert_eq!((timers.next(), timers.take_due(5)), (Some(6), vec![]));
        timers.postpone(10);
        assert_eq!(timers.take_due(16), ['b']);
        assert_eq!((timers.take_due(17), timers.next()), (vec!['a'], None));
    }
}
