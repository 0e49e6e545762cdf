//! The words of a robot while goals run: the newest feedback of each, and the newest states. Without IO.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use bytes::Bytes;
use ledger_base::hash::Hash;

use crate::routes::{actions::frame::GoalId, ends::CALLS_MAX};

/// The newest of each kind, until it is time to say them.
#[derive(Debug)]
pub(super) struct FeedbackBuffer {
    every: Duration,
    newest: BTreeMap<(Hash, GoalId), Bytes>,
    /// Before it nothing is said.
    next: Option<Instant>,
}

impl FeedbackBuffer {
    pub(super) fn new(every: Duration) -> Self {
        Self { every, newest: BTreeMap::new(), next: None }
    }

    /// Keeps a message. True if it takes the place of one that nobody has heard.
    pub(super) fn keep(&mut self, what: Hash, goal: GoalId, message: Bytes, now: Instant) -> bool {
        if self.newest.len() > CALLS_MAX {
            return true; // There are not so many goals.
        }
        self.next.get_or_insert(now);
        self.newest.insert((what, goal), message).is_some()
    }

    /// When something is to be said; none if nothing is.
    pub(super) fn due(&self) -> Option<Instant> {
        self.next.filter(|_| !self.newest.is_empty())
    }

    /// Gives out all that is to be said, and nothing more for a while.
    pub(super) fn take(&mut self, now: Instant) -> Vec<(Hash, Bytes)> {
        self.next = Some(now + self.every);
        std::mem::take(&mut self.newest).into_iter().map(|((what, _), message)| (what, message)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVERY: Duration = Duration::from_millis(100);

    #[test]
    fn the_newest_of_each_goal_is_said_so_often_and_the_last_one_always() {
        let (mut said, start) = (FeedbackBuffer::new(EVERY), Instant::now());
        let text = |number: u8| Bytes::copy_from_slice(&[number]);
        assert!(!said.keep(Hash([1; 32]), [1; 16], text(0), start));
        assert_eq!(said.due(), Some(start), "the first one at once");
        assert_eq!(said.take(start).len(), 1);
        assert_eq!(said.due(), None);
        assert!(!said.keep(Hash([1; 32]), [1; 16], text(1), start));
        assert!(said.keep(Hash([1; 32]), [1; 16], text(2), start));
        assert!(!said.keep(Hash([1; 32]), [2; 16], text(3), start));
        assert_eq!(said.due(), Some(start + EVERY));
        let all = said.take(start + EVERY);
        assert_eq!(all, [(Hash([1; 32]), text(2)), (Hash([1; 32]), text(3))]);
        assert_eq!(said.due(), None);
    }
}
