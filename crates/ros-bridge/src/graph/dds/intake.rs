//! The samples that a reader accepts: none twice, none out of order. DDS promises that for one match; a writer that was lost and comes back
//! is matched again, and may send again what it keeps.

use std::collections::{BTreeMap, BTreeSet};

use rtps::guid::{Guid, SequenceNumber};

/// Most writers remembered at a time; those that left are forgotten first.
const WRITERS_MAX: usize = 4096;

/// The last sequence number of each writer.
#[derive(Debug, Default)]
pub(crate) struct Intake {
    last: BTreeMap<Guid, SequenceNumber>,
}

impl Intake {
    /// The same for a writer of which nothing says whether it is still there: any may be forgotten.
    #[cfg(feature = "zenoh")]
    pub(crate) fn admits_any(&mut self, writer: Guid, sequence: SequenceNumber) -> bool {
        self.admits(writer, sequence, &BTreeSet::new())
    }

    /// Is this sample new, and not overtaken by a later one of its writer? `present` are the writers matched now.
    pub(crate) fn admits(&mut self, writer: Guid, sequence: SequenceNumber, present: &BTreeSet<Guid>) -> bool {
        if self.last.get(&writer).is_some_and(|last| sequence <= *last) {
            return false;
        }
        if self.last.len() >= WRITERS_MAX && !self.last.contains_key(&writer) {
            self.last.retain(|known, _| present.contains(known));
            if self.last.len() >= WRITERS_MAX {
                self.last.pop_first();
            }
        }
        self.last.insert(writer, sequence);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn admits(intake: &mut Intake, writer: u128, sequence: i64, present: &BTreeSet<Guid>) -> bool {
        intake.admits(guid(writer), SequenceNumber(sequence), present)
    }

    fn guid(number: u128) -> Guid {
        Guid::from_bytes(number.to_be_bytes())
    }

    #[test]
    fn a_sample_comes_in_once_and_never_after_a_later_one() {
        let (mut intake, none) = (Intake::default(), BTreeSet::new());
        assert!(admits(&mut intake, 7, 5, &none));
        assert!(!admits(&mut intake, 7, 5, &none));
        assert!(!admits(&mut intake, 7, 4, &none));
        assert!(admits(&mut intake, 8, 4, &none));
        assert!(admits(&mut intake, 7, 6, &none));
    }

    #[test]
    fn writers_that_left_do_not_fill_the_memory() {
        let (mut intake, present) = (Intake::default(), BTreeSet::from([guid(7)]));
        assert!(admits(&mut intake, 7, 1, &present));
        for number in 0..3 * WRITERS_MAX as u128 {
            admits(&mut intake, number << 8 | 1, 1, &present);
        }
        assert!(intake.last.len() <= WRITERS_MAX);
        assert!(!admits(&mut intake, 7, 1, &present), "a present writer is not forgotten");
    }
}
