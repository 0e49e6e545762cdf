//! Which samples a reader lets in: none of our own, none twice, none out of order.

use std::collections::{BTreeMap, BTreeSet};

/// Most writers remembered at a time; those that left are forgotten first.
const WRITERS_MAX: usize = 4096;

/// The outcome for a sample at the filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// New: give it out.
    Admit,
    /// Published by this participant: giving it out would be a loop.
    Own,
    /// Already seen, or overtaken by a later one of the same writer.
    Seen,
}

/// The last sequence number of each writer.
#[derive(Debug)]
pub(super) struct Intake {
    own_prefix: [u8; 12],
    last: BTreeMap<[u8; 16], i64>,
}

impl Intake {
    pub(super) fn new(own_prefix: [u8; 12]) -> Self {
        Self { own_prefix, last: BTreeMap::new() }
    }

    /// Decides on a sample; `present` are the writers matched now.
    pub(super) fn judge(&mut self, writer: [u8; 16], sequence: i64, present: &BTreeSet<[u8; 16]>) -> Verdict {
        if writer.starts_with(&self.own_prefix) {
            return Verdict::Own;
        }
        if self.last.get(&writer).is_some_and(|last| sequence <= *last) {
            return Verdict::Seen;
        }
        if self.last.len() >= WRITERS_MAX && !self.last.contains_key(&writer) {
            self.last.retain(|known, _| present.contains(known));
            if self.last.len() >= WRITERS_MAX {
                self.last.pop_first();
            }
        }
        self.last.insert(writer, sequence);
        Verdict::Admit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WRITER: [u8; 16] = [7; 16];

    #[test]
    fn samples_of_the_same_participant_are_kept_out() {
        let mut intake = Intake::new([7; 12]);
        assert_eq!(intake.judge(WRITER, 1, &BTreeSet::new()), Verdict::Own);
    }

    #[test]
    fn a_sample_comes_in_once_and_never_after_a_later_one() {
        let mut intake = Intake::new([0; 12]);
        let none = BTreeSet::new();
        assert_eq!(intake.judge(WRITER, 5, &none), Verdict::Admit);
        assert_eq!(intake.judge(WRITER, 5, &none), Verdict::Seen);
        assert_eq!(intake.judge(WRITER, 4, &none), Verdict::Seen);
        assert_eq!(intake.judge([8; 16], 4, &none), Verdict::Admit);
        assert_eq!(intake.judge(WRITER, 6, &none), Verdict::Admit);
    }

    #[test]
    fn writers_that_left_do_not_fill_the_memory() {
        let mut intake = Intake::new([0; 12]);
        let present = BTreeSet::from([WRITER]);
        assert_eq!(intake.judge(WRITER, 1, &present), Verdict::Admit);
        for number in 0..3 * WRITERS_MAX as u128 {
            intake.judge((number << 8 | 1).to_be_bytes(), 1, &present);
        }
        assert!(intake.last.len() <= WRITERS_MAX);
        assert_eq!(intake.judge(WRITER, 1, &present), Verdict::Seen, "a present writer is not forgotten");
    }
}
