//! Subscribers, and the events for which each of them waits. A block wakes only those whom one of its events may
//! concern: what a subscriber of one robot costs does not grow with what the others do.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Everybody who waits for events, by what they wait for.
#[derive(Default)]
pub(super) struct Interests {
    table: Mutex<Table>,
}

/// The table, locked: while somebody is entered, no block comes in between.
#[derive(Default)]
pub(super) struct Table {
    /// By subject of the events.
    some: HashMap<String, Vec<Arc<Mark>>>,
    /// Those whom everything concerns.
    all: Vec<Arc<Mark>>,
}

/// The blocks that one of them has still to look at.
pub(super) struct Mark {
    unseen: Mutex<Unseen>,
    wake: Notify,
}

/// Every height with something of concern lies between these; there is none if `first` is above `last`.
struct Unseen {
    first: u64,
    last: u64,
}

/// An entry of somebody who waits. It ends with this.
pub(crate) struct Interest {
    interests: Arc<Interests>,
    /// Empty: everything.
    subjects: Vec<String>,
    mark: Arc<Mark>,
}

impl Interests {
    pub(super) fn lock(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Enters somebody who has everything up to `height` still to look at. No subjects mean all.
    pub(super) fn enter(self: &Arc<Self>, table: &mut Table, subjects: Vec<String>, height: u64) -> Interest {
        let mark = Arc::new(Mark { unseen: Mutex::new(Unseen { first: 0, last: height }), wake: Notify::new() });
        if subjects.is_empty() {
            table.all.push(Arc::clone(&mark));
        }
        for subject in &subjects {
            table.some.entry(subject.clone()).or_default().push(Arc::clone(&mark));
        }
        Interest { interests: Arc::clone(self), subjects, mark }
    }
}

impl Table {
    /// Notes that a block has events about these subjects; answers whom to [wake](Mark::wake).
    pub(super) fn mark<'a>(&self, height: u64, subjects: impl Iterator<Item = &'a str>) -> Vec<Arc<Mark>> {
        let mut concerned = Vec::new();
        for subject in subjects {
            let marks = self.some.get(subject).into_iter().flatten().chain(&self.all);
            concerned.extend(marks.filter(|mark| mark.note(height)).map(Arc::clone));
        }
        concerned
    }
}

impl Mark {
    /// False if that height was noted before.
    fn note(&self, height: u64) -> bool {
        let mut unseen = self.lock();
        if unseen.first > unseen.last {
            *unseen = Unseen { first: height, last: height };
            return true;
        }
        let new = unseen.last != height;
        unseen.last = height;
        new
    }

    pub(super) fn wake(&self) {
        self.wake.notify_one();
    }

    fn lock(&self) -> MutexGuard<'_, Unseen> {
        self.unseen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Interest {
    /// The first height, up to `reached`, that may concern this subscriber and was not taken yet; with it everything up
    /// to `reached` is taken. None: nothing up to there concerns it.
    pub(crate) fn take(&self, reached: u64) -> Option<u64> {
        let mut unseen = self.mark.lock();
        let Unseen { first, last } = *unseen;
        if first > last || first > reached {
            return None;
        }
        unseen.first = reached + 1;
        Some(first)
    }

    /// Waits until something may concern this subscriber.
    pub(crate) async fn wait(&self) {
        self.mark.wake.notified().await;
    }
}

impl Drop for Interest {
    fn drop(&mut self) {
        let mut table = self.interests.lock();
        let others = |mark: &Arc<Mark>| !Arc::ptr_eq(mark, &self.mark);
        if self.subjects.is_empty() {
            table.all.retain(others);
        }
        for subject in &self.subjects {
            if let Some(marks) = table.some.get_mut(subject) {
                marks.retain(others);
                if marks.is_empty() {
                    table.some.remove(subject);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn enter(interests: &Arc<Interests>, subjects: &[&str], height: u64) -> Interest {
        let subjects = subjects.iter().map(|subject| (*subject).to_owned()).collect();
        interests.enter(&mut interests.lock(), subjects, height)
    }

    fn woken(interests: &Arc<Interests>, height: u64, subjects: &[&str]) -> usize {
        interests.lock().mark(height, subjects.iter().copied()).len()
    }

    #[test]
    fn a_block_wakes_those_whom_its_events_concern_once_and_nobody_else() {
        let interests = Arc::new(Interests::default());
        let (a, b, all) = (enter(&interests, &["a"], 0), enter(&interests, &["b", "c"], 0), enter(&interests, &[], 0));
        for interest in [&a, &b, &all] {
            assert_eq!(interest.take(0), Some(0));
        }
        assert_eq!(woken(&interests, 1, &[]), 0, "an empty block concerns nobody");
        assert_eq!(woken(&interests, 2, &["a", "a"]), 2);
        assert_eq!(woken(&interests, 3, &["c", "b"]), 2);
        assert_eq!((a.take(3), b.take(3), all.take(3)), (Some(2), Some(3), Some(2)));
        assert_eq!((a.take(3), b.take(3), all.take(3)), (None, None, None));
        drop(a);
        assert_eq!(woken(&interests, 4, &["a"]), 1, "who is gone is not woken");
    }

    #[test]
    fn what_was_there_before_is_looked_at_from_the_beginning() {
        let interests = Arc::new(Interests::default());
        let interest = enter(&interests, &["a"], 7);
        assert_eq!(interest.take(7), Some(0));
        assert_eq!(interest.take(9), None);
    }

    #[test]
    fn a_block_that_comes_while_another_is_looked_at_is_not_forgotten() {
        let interests = Arc::new(Interests::default());
        let interest = enter(&interests, &["a"], 0);
        assert_eq!(interest.take(0), Some(0));
        // The head was read before block 6 came, and the marks are taken after it.
        let reached = 5;
        woken(&interests, 5, &["a"]);
        woken(&interests, 6, &["a"]);
        assert_eq!(interest.take(reached), Some(5));
        assert_eq!(interest.take(6), Some(6));
        assert_eq!(interest.take(6), None);
    }

    #[test]
    fn who_is_gone_leaves_nothing_behind() {
        let interests = Arc::new(Interests::default());
        drop(enter(&interests, &["a", "b", "a"], 0));
        drop(enter(&interests, &[], 0));
        let table = interests.lock();
        assert!(table.some.is_empty() && table.all.is_empty());
    }
}
