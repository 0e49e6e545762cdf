//! Where entries are on disk, and their terms.
//!
//! Sparse, so that memory stays flat however long the log: the place of one entry in many is kept, the others are found
//! by reading on from there. Terms are kept for each run of entries of one term.

use std::collections::VecDeque;

use crate::segment::{Base, Contents, LogPosition, MARK_BYTES};

/// The place of an entry from which those after it, up to the next mark, follow in the same file and in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Mark {
    pub(super) index: u64,
    /// First byte of its record.
    pub(super) position: LogPosition,
}

/// The logical log: every index once, superseded entries gone.
#[derive(Debug, Default)]
pub(super) struct LogIndex {
    /// The entry that the log follows.
    base: Base,
    /// Ascending; none above `durable`.
    marks: VecDeque<Mark>,
    /// First index of each run of entries of one term, and the term.
    terms: VecDeque<(u64, u64)>,
    /// Newest durable entry.
    durable: u64,
    /// Newest entry, durable or not.
    last: u64,
    /// The entry that was written last, whether or not it has been superseded since.
    written: u64,
}

impl LogIndex {
    /// An empty log that goes on after `base`.
    pub(super) fn new(base: Base) -> Self {
        Self { base, durable: base.index, last: base.index, ..Self::default() }
    }

    pub(super) const fn base(&self) -> Base {
        self.base
    }

    pub(super) const fn last(&self) -> u64 {
        self.last
    }

    /// Newest durable entry.
    pub(super) const fn durable(&self) -> u64 {
        self.durable
    }

    /// The marks from which the durable entries from `index` on are found, in order; none if it is not one of them.
    pub(super) fn marks(&self, index: u64) -> impl Iterator<Item = Mark> {
        let has = index > self.base.index && index <= self.durable;
        let from = self.marks.partition_point(|mark| mark.index <= index).checked_sub(1).filter(|_| has);
        self.marks.range(from.unwrap_or(self.marks.len())..).copied()
    }

    /// The term of an entry, or of the one that the log follows.
    pub(super) fn term(&self, index: u64) -> Option<u64> {
        if index > self.last || index < self.base.index {
            return None;
        }
        if index == self.base.index {
            return Some(self.base.term);
        }
        let run = self.terms.partition_point(|(first, _)| *first <= index).checked_sub(1)?;
        self.terms.get(run).map(|(_, term)| *term)
    }

    /// Adds an entry, superseding what has its index or a higher one. `index` is at most one above the last.
    ///
    /// At or below the base only while a log is read that was cut short: there an entry that is left may have
    /// superseded one that is gone.
    pub(super) fn append(&mut self, index: u64, term: u64) {
        self.durable = self.durable.min(index.saturating_sub(1));
        while self.marks.back().is_some_and(|mark| mark.index >= index) {
            self.marks.pop_back();
        }
        while self.terms.back().is_some_and(|(first, _)| *first >= index) {
            self.terms.pop_back();
        }
        if index == self.base.index {
            self.base.term = term;
        } else if index > self.base.index && self.terms.back().is_none_or(|(_, last)| *last != term) {
            self.terms.push_back((index, term));
        }
        self.last = index;
    }

    /// Notes that entry `index` was written, but had been superseded before it was durable.
    pub(super) const fn pass(&mut self, index: u64) {
        self.written = index;
    }

    /// Notes that entry `index` is durable at `position`, which is behind what was written before it. False if it is
    /// not the one after the newest durable entry.
    pub(super) fn place(&mut self, index: u64, position: LogPosition) -> bool {
        let follows = index == std::mem::replace(&mut self.written, index) + 1;
        if index != self.durable + 1 || index > self.last {
            return false;
        }
        self.durable = index;
        if index <= self.base.index {
            return true;
        }
        let near = |mark: &Mark| {
            mark.position.sequence == position.sequence
                && position.offset.checked_sub(mark.position.offset).is_some_and(|bytes| bytes < MARK_BYTES)
        };
        if !follows || !self.marks.back().is_some_and(near) {
            self.marks.push_back(Mark { index, position });
        }
        true
    }

    /// Takes over what a whole segment holds, as if each of its entries was appended and placed. The first of them is
    /// at most one above the last so far.
    pub(super) fn adopt(&mut self, sequence: u32, contents: &Contents) {
        let Some((first, term)) = contents.first() else { return };
        self.append(first, term);
        let ends = contents.terms.iter().skip(1).map(|(next, _)| *next).chain([contents.last.saturating_add(1)]);
        for ((first, term), end) in contents.terms.iter().copied().zip(ends) {
            if first <= self.base.index && self.base.index < end {
                self.base.term = term;
            }
            if end > self.base.index + 1 && self.terms.back().is_none_or(|(_, before)| *before != term) {
                self.terms.push_back((first.max(self.base.index + 1), term));
            }
        }
        let mark =
            |(index, offset): &(u64, u32)| Mark { index: *index, position: LogPosition { sequence, offset: *offset } };
        self.marks.extend(contents.marks.iter().map(mark));
        (self.durable, self.last, self.written) = (contents.last, contents.last, contents.last);
    }

    /// Forgets what is before entry `first` (in the log, or one above its end) and in segments before `oldest`, which
    /// are none of its or later entries.
    pub(super) fn drop_before(&mut self, first: u64, oldest: u32) {
        let Some(term) = first.checked_sub(1).and_then(|index| self.term(index)) else { return };
        self.base = Base { index: first - 1, term };
        while self.marks.front().is_some_and(|mark| mark.position.sequence < oldest) {
            self.marks.pop_front();
        }
        let run = self.terms.partition_point(|(start, _)| *start <= first);
        if let Some(before) = run.checked_sub(1) {
            self.terms.drain(..before);
            if let Some((start, _)) = self.terms.front_mut() {
                *start = (*start).max(first);
            }
        }
        self.marks.shrink_to(self.marks.len() * 2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(offset: u32) -> LogPosition {
        LogPosition { sequence: 1, offset }
    }

    #[test]
    fn a_lower_index_supersedes_terms_and_places() {
        let mut index = LogIndex::default();
        for (entry, term) in [(1, 1), (2, 1), (3, 2), (4, 4)] {
            index.append(entry, term);
        }
        assert!(index.place(1, at(96)) && index.place(2, at(150)) && index.place(3, at(200)));
        assert!(!index.place(5, at(250)));
        assert_eq!(
            [0, 1, 2, 3, 4, 5].map(|at| index.term(at)),
            [0, 1, 1, 2, 4, 9].map(|term| (term < 9).then_some(term))
        );
        index.append(2, 5);
        assert_eq!([1, 2, 3].map(|at| index.term(at)), [Some(1), Some(5), None]);
        assert_eq!((index.durable(), index.last()), (1, 2));
        assert_eq!(index.marks(1).collect::<Vec<_>>(), [Mark { index: 1, position: at(96) }]);
        assert_eq!(index.marks(2).count(), 0);
        assert!(index.place(2, at(300)));
        assert_eq!(index.marks(2).collect::<Vec<_>>(), [Mark { index: 2, position: at(300) }]);
    }

    #[test]
    fn taking_over_a_segment_is_the_same_as_appending_its_entries() {
        let segments: [&[(u64, u64)]; 4] = [
            &[(1, 1), (2, 1), (3, 2), (4, 2), (5, 2)],
            &[(6, 2), (7, 2), (8, 3), (9, 3)],
            &[(7, 4), (8, 4), (9, 4), (8, 5), (9, 5), (10, 6), (11, 6)],
            &[(12, 6), (13, 7)],
        ];
        for base in 0..12 {
            let new = || LogIndex::new(Base { index: base, term: u64::from(base > 0) });
            let (mut one, mut other) = (new(), new());
            for (sequence, entries) in (1..).zip(segments) {
                if sequence < 3 && entries.iter().all(|(index, _)| *index <= base) {
                    // Dropped with all that it had.
                    continue;
                }
                let mut contents = Contents::default();
                for (place, (index, term)) in (0..).zip(entries) {
                    let position = LogPosition { sequence, offset: 96 + place * 50_000 };
                    one.append(*index, *term);
                    assert!(one.place(*index, position));
                    contents.add(*index, *term, position.offset);
                }
                other.adopt(sequence, &contents);
                assert_eq!((one.base, one.last, one.durable), (other.base, other.last, other.durable), "base {base}");
                assert_eq!(one.terms, other.terms, "base {base}");
                assert!(base > 0 || one.marks == other.marks);
                for index in base + 1..=one.last {
                    assert!(other.marks(index).next().is_some_and(|mark| mark.index <= index), "base {base}");
                }
            }
        }
    }

    #[test]
    fn memory_does_not_grow_with_every_entry_and_shrinks_when_the_front_is_dropped() {
        let mut index = LogIndex::default();
        for entry in 1..=100_000 {
            index.append(entry, entry / 40_000);
            let position = LogPosition { sequence: 1 + entry as u32 / 1000, offset: 96 + entry as u32 % 1000 * 400 };
            assert!(index.place(entry, position));
        }
        let kept = index.marks.len();
        assert!(kept < 500, "{kept}");
        index.drop_before(50_000, 51);
        assert_eq!((index.base().index, index.last(), index.term(49_998)), (49_999, 100_000, None));
        assert_eq!([49_999, 50_000, 80_000].map(|at| index.term(at)), [Some(1), Some(1), Some(2)]);
        assert_eq!(index.marks(50_000).next().map(|mark| mark.index), Some(50_000));
        assert!(index.marks.len() * 2 <= kept + 4);
        index.drop_before(100_001, 102);
        assert_eq!((index.term(100_000), index.marks.len(), index.last()), (Some(2), 0, 100_000));
        index.append(100_001, 7);
        assert_eq!(index.term(100_001), Some(7));
    }

    #[test]
    fn what_was_written_in_vain_is_not_walked_over() {
        let mut index = LogIndex::default();
        for (entry, term) in [(1, 1), (2, 1), (3, 1)] {
            index.append(entry, term);
        }
        index.append(2, 2);
        // The write of 1 to 3 was under way: only 1 counts.
        assert!(index.place(1, at(96)));
        index.pass(2);
        index.pass(3);
        assert!(index.place(2, at(300)));
        assert_eq!(index.marks(1).map(|mark| mark.position.offset).collect::<Vec<_>>(), [96, 300]);
    }
}
