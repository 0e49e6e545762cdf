//! Which sequence number each publisher has reached: nothing passes twice, nothing passes backwards.

use ledger_contract::Sequence;
use std::collections::BTreeMap;

/// Most publishers remembered at a time.
pub(super) const PUBLISHERS_MAX: usize = 4096;
/// A publisher is remembered for so long beyond the age that its service accepts, microseconds. By then the voters have answered
/// often, or nothing passes.
const LONGER_US: u64 = 60_000_000;

/// The last numbers of all publishers of a service.
#[derive(Debug, Default)]
pub(super) struct Sequences {
    last: BTreeMap<String, Last>,
}

#[derive(Debug)]
struct Last {
    epoch: u64,
    seq: u64,
    /// Until then one of this publisher's messages may still pass, by the steady clock (microseconds). After it the publisher may be
    /// forgotten.
    until: u64,
}

impl Sequences {
    /// May these numbers follow?
    pub(super) fn may_follow(&self, publisher: &str, sequence: Sequence, epoch: u64, first_seq: u64) -> bool {
        let anew = |last: &Last| sequence == Sequence::PerEpoch && epoch > last.epoch;
        self.last.get(publisher).is_none_or(|last| anew(last) || first_seq > last.seq)
    }

    /// Epoch and number of the last message of a publisher.
    pub(super) fn reached(&self, publisher: &str) -> Option<(u64, u64)> {
        self.last.get(publisher).map(|last| (last.epoch, last.seq))
    }

    /// Takes note of a message that passed now, by the steady clock in microseconds, and for how many microseconds more it can pass. False if there is no room: then it must not pass.
    pub(super) fn note(&mut self, publisher: &str, (epoch, seq): (u64, u64), expires_in: u64, now: u64) -> bool {
        let until = now.saturating_add(expires_in).saturating_add(LONGER_US);
        if let Some(last) = self.last.get_mut(publisher) {
            *last = Last { epoch, seq, until: last.until.max(until) };
            return true;
        }
        if self.last.len() >= PUBLISHERS_MAX {
            self.last.retain(|_, last| last.until >= now);
        }
        let room = self.last.len() < PUBLISHERS_MAX;
        if room {
            self.last.insert(publisher.to_owned(), Last { epoch, seq, until });
        }
        room
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_only_grow_and_each_epoch_counts_anew_where_the_rule_says_so() {
        let mut sequences = Sequences::default();
        assert!(sequences.note("a", (1, 10), 100, 0));
        for sequence in [Sequence::PerEpoch, Sequence::PerPublisher] {
            assert!(!sequences.may_follow("a", sequence, 1, 10));
            assert!(sequences.may_follow("a", sequence, 1, 11));
            assert!(sequences.may_follow("b", sequence, 1, 1));
        }
        assert!(sequences.may_follow("a", Sequence::PerEpoch, 2, 1));
        assert!(!sequences.may_follow("a", Sequence::PerPublisher, 2, 1));
    }

    #[test]
    fn publishers_are_forgotten_only_when_nothing_of_them_can_come_again() {
        let mut sequences = Sequences::default();
        for number in 0..PUBLISHERS_MAX {
            assert!(sequences.note(&number.to_string(), (1, 1), 100, 0));
        }
        assert!(!sequences.note("late", (1, 1), 200, 100 + LONGER_US), "all may still be replayed");
        assert!(sequences.note("late", (1, 1), 200, 101 + LONGER_US));
    }
}
