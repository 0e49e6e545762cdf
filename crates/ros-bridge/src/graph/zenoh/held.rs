//! Samples that came before a publisher of their topic was announced: a token may come a moment later. Without IO.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// For so long a sample waits for a token.
const WAIT_MAX: Duration = Duration::from_secs(1);
/// Most samples that wait.
const HELD_MAX: usize = 64;

/// The samples that wait, the oldest first.
#[derive(Debug)]
pub(super) struct Held<T>(VecDeque<(Instant, T)>);

impl<T> Default for Held<T> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<T> Held<T> {
    /// Adds one. Returns the oldest if too many wait.
    pub(super) fn push(&mut self, one: T, now: Instant) -> Option<T> {
        let oldest = if self.0.len() >= HELD_MAX { self.0.pop_front() } else { None };
        self.0.push_back((now, one));
        oldest.map(|(_, one)| one)
    }

    /// Does anything wait?
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Takes those that are announced now, in their order, and those that have waited too long.
    pub(super) fn release(&mut self, now: Instant, is_announced: impl Fn(&T) -> bool) -> (Vec<T>, Vec<T>) {
        let (mut released, mut late) = (Vec::new(), Vec::new());
        for (since, one) in std::mem::take(&mut self.0) {
            if is_announced(&one) {
                released.push(one);
            } else if now.saturating_duration_since(since) >= WAIT_MAX {
                late.push(one);
            } else {
                self.0.push_back((since, one));
            }
        }
        (released, late)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_announced_is_released_in_order_and_the_rest_waits_a_second() {
        let (mut held, start) = (Held::default(), Instant::now());
        for one in 1..=3 {
            assert_eq!(held.push(one, start), None);
        }
        assert_eq!(held.release(start, |one| *one != 2), (vec![1, 3], Vec::new()));
        assert!(!held.is_empty());
        assert_eq!(held.release(start + WAIT_MAX, |_| false), (Vec::new(), vec![2]));
        assert!(held.is_empty());
    }

    #[test]
    fn if_too_many_wait_the_oldest_is_lost() {
        let (mut held, start) = (Held::default(), Instant::now());
        let lost: Vec<usize> = (0..HELD_MAX + 2).filter_map(|one| held.push(one, start)).collect();
        assert_eq!(lost, [0, 1]);
    }
}
