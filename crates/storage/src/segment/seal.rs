//! The content of a finished segment, written into the one after it: opening a store then need not read it again.

use super::header::{HEADER_BYTES, take};

/// How many bytes of records may lie between two entries whose places are noted: what finding one entry costs at most.
pub(crate) const MARK_BYTES: u32 = 128 << 10;

/// Longest payload of a seal. A segment that changes its term more often than fits is finished without one, and read
/// when the store is opened.
pub const SEAL_BYTES_MAX: usize = 1 << 20;

/// Bytes of a seal before its lists, of a run of one term, and of a mark.
const FIELDS_BYTES: usize = 20;
const RUN_BYTES: usize = 16;
const MARK_ITEM_BYTES: usize = 12;

/// Which entries a segment holds and where: those that no later entry of the same segment supersedes. They are gapless,
/// and supersede whatever older segments have from the first of them on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Contents {
    /// The entry that was written last; 0 if there is none.
    pub(crate) last: u64,
    /// First index of each run of entries of one term, and the term.
    pub(crate) terms: Vec<(u64, u64)>,
    /// Entries from which those after them, up to the next mark, follow in order, and the offsets of their records.
    pub(crate) marks: Vec<(u64, u32)>,
}

/// The word of a segment about the one before it.
///
/// Payload: header CRC of the segment before `u32`; its last index `u64`; how many runs and how many marks, `u32` each.
/// Then come the runs (first index, term; `u64` each) and the marks (index `u64`, offset `u32`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seal {
    /// CRC of the header of the segment that is meant: another file under its name is noticed.
    pub(crate) segment_crc: u32,
    /// Its content.
    pub(crate) contents: Contents,
}

impl Contents {
    /// Takes note of the entry whose record was written at `offset`.
    pub(crate) fn add(&mut self, index: u64, term: u64, offset: u32) {
        while self.terms.last().is_some_and(|(first, _)| *first >= index) {
            self.terms.pop();
        }
        while self.marks.last().is_some_and(|(marked, _)| *marked >= index) {
            self.marks.pop();
        }
        if self.terms.last().is_none_or(|(_, last)| *last != term) {
            self.terms.push((index, term));
        }
        let near = |(_, at): &(u64, u32)| offset.checked_sub(*at).is_some_and(|bytes| bytes < MARK_BYTES);
        if index != self.last.saturating_add(1) || !self.marks.last().is_some_and(near) {
            self.marks.push((index, offset));
        }
        self.last = index;
    }

    /// The first entry and its term; none if there is no entry.
    pub(crate) fn first(&self) -> Option<(u64, u64)> {
        self.terms.first().copied()
    }

    /// Term of the last entry.
    pub(crate) fn last_term(&self) -> Option<u64> {
        self.terms.last().map(|(_, term)| *term)
    }

    fn is_consistent(&self) -> bool {
        let rising = |pair: &[(u64, u64)]| matches!(pair, [one, other] if one.0 < other.0 && one.1 <= other.1);
        let follows = |pair: &[(u64, u32)]| matches!(pair, [one, other] if one.0 < other.0 && one.1 < other.1);
        let begins = self.terms.first().map(|(index, _)| *index) == self.marks.first().map(|(index, _)| *index);
        let ends = [self.terms.last().map(|(index, _)| *index), self.marks.last().map(|(index, _)| *index)];
        let inside = self.marks.first().is_none_or(|(_, offset)| u64::from(*offset) >= HEADER_BYTES);
        begins
            && inside
            && self.first().is_none_or(|(first, _)| first > 0)
            && ends.iter().all(|end| end.is_none_or(|end| end <= self.last))
            && self.terms.windows(2).all(rising)
            && self.marks.windows(2).all(follows)
    }
}

impl Seal {
    /// Bytes of the payload.
    pub(crate) fn bytes(&self) -> usize {
        FIELDS_BYTES + self.contents.terms.len() * RUN_BYTES + self.contents.marks.len() * MARK_ITEM_BYTES
    }

    /// The payload.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let Self { segment_crc, contents: Contents { last, terms, marks } } = self;
        let count = |items: usize| u32::try_from(items).unwrap_or(u32::MAX).to_le_bytes();
        let mut bytes = Vec::with_capacity(self.bytes());
        bytes.extend(segment_crc.to_le_bytes());
        bytes.extend(last.to_le_bytes());
        bytes.extend(count(terms.len()));
        bytes.extend(count(marks.len()));
        for (index, term) in terms {
            bytes.extend(index.to_le_bytes());
            bytes.extend(term.to_le_bytes());
        }
        for (index, offset) in marks {
            bytes.extend(index.to_le_bytes());
            bytes.extend(offset.to_le_bytes());
        }
        bytes
    }

    /// Reads a payload; the error says what is wrong.
    pub(super) fn from_bytes(payload: &[u8]) -> Result<Self, &'static str> {
        const LENGTH: &str = "the length of the seal does not match";
        if payload.len() > SEAL_BYTES_MAX {
            return Err("the seal exceeds its limit");
        }
        let mut rest = payload;
        let segment_crc = take(&mut rest).map(u32::from_le_bytes).ok_or(LENGTH)?;
        let last = take(&mut rest).map(u64::from_le_bytes).ok_or(LENGTH)?;
        let runs = take(&mut rest).map(u32::from_le_bytes).ok_or(LENGTH)? as usize;
        let marks = take(&mut rest).map(u32::from_le_bytes).ok_or(LENGTH)? as usize;
        let (runs, marks) = runs
            .checked_mul(RUN_BYTES)
            .and_then(|bytes| rest.split_at_checked(bytes))
            .filter(|(_, rest)| marks.checked_mul(MARK_ITEM_BYTES) == Some(rest.len()))
            .ok_or(LENGTH)?;
        let run =
            |mut bytes: &[u8]| Some((u64::from_le_bytes(take(&mut bytes)?), u64::from_le_bytes(take(&mut bytes)?)));
        let mark =
            |mut bytes: &[u8]| Some((u64::from_le_bytes(take(&mut bytes)?), u32::from_le_bytes(take(&mut bytes)?)));
        let terms = runs.chunks_exact(RUN_BYTES).filter_map(run).collect();
        let marks = marks.chunks_exact(MARK_ITEM_BYTES).filter_map(mark).collect();
        let contents = Contents { last, terms, marks };
        if !contents.is_consistent() {
            return Err("the seal contradicts itself");
        }
        Ok(Self { segment_crc, contents })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn contents(entries: &[(u64, u64, u32)]) -> Contents {
        let mut contents = Contents::default();
        for (index, term, offset) in entries {
            contents.add(*index, *term, *offset);
        }
        contents
    }

    #[test]
    fn what_is_superseded_in_the_segment_does_not_count() {
        let some = contents(&[(10, 1, 96), (11, 1, 150), (12, 2, 200), (11, 3, 300), (12, 3, 400)]);
        assert_eq!((some.first(), some.last, some.last_term()), (Some((10, 1)), 12, Some(3)));
        assert_eq!((some.terms, some.marks), (vec![(10, 1), (11, 3)], vec![(10, 96), (11, 300)]));
        let lower = contents(&[(10, 1, 96), (11, 1, 150), (8, 2, 200), (9, 2, 300)]);
        assert_eq!((lower.terms, lower.marks, lower.last), (vec![(8, 2)], vec![(8, 200)], 9));
    }

    #[test]
    fn places_are_noted_so_that_no_way_is_long() {
        let many: Vec<_> = (1..=1000u64).map(|index| (index, 1, 96 + (index as u32 - 1) * 1000)).collect();
        let contents = contents(&many);
        assert_eq!((contents.terms.len(), contents.marks.len()), (1, 8));
        assert!(
            contents.marks.windows(2).all(|pair| matches!(pair, [one, other] if other.1 - one.1 < MARK_BYTES + 1000))
        );
    }

    #[test]
    fn a_seal_reads_as_it_was_written_and_nothing_else_does() {
        let seal = Seal { segment_crc: 77, contents: contents(&[(3, 1, 96), (4, 2, 200), (4, 3, 300)]) };
        let bytes = seal.to_bytes();
        assert_eq!(bytes.len(), seal.bytes());
        assert_eq!(Seal::from_bytes(&bytes).unwrap(), seal);
        let none = Seal { segment_crc: 1, contents: Contents::default() };
        assert_eq!(Seal::from_bytes(&none.to_bytes()).unwrap(), none);
        for cut in 0..bytes.len() {
            assert!(Seal::from_bytes(bytes.get(..cut).unwrap()).is_err(), "cut at {cut}");
        }
        assert!(Seal::from_bytes(&[bytes.clone(), vec![0]].concat()).is_err());
        assert!(Seal::from_bytes(&[0xff; 64]).is_err(), "counts beyond any memory");
        let mut turned = seal;
        turned.contents.marks.reverse();
        assert!(Seal::from_bytes(&turned.to_bytes()).is_err());
    }
}
