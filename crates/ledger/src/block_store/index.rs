//! Where each entry is on disk, and its term.
//!
//! Twelve bytes an entry, plus a few for each change of term. Only this file knows that every location is in memory, so
//! it may become sparse (one location in many, the rest found by reading on from there).

/// Where a durable entry is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Location {
    /// Sequence number of its segment.
    pub(super) sequence: u32,
    /// First byte of its record.
    pub(super) offset: u32,
    /// Bytes of its record.
    pub(super) bytes: u32,
}

const _: () = assert!(size_of::<Location>() <= 16);

/// The logical log: every index once, superseded entries gone.
#[derive(Debug, Default)]
pub(super) struct LogIndex {
    /// Location of entry `i` at place `i - 1`; ends with the newest durable entry.
    locations: Vec<Location>,
    /// First index of each run of entries of one term, and the term.
    terms: Vec<(u64, u64)>,
    /// Newest entry, durable or not.
    last: u64,
}

impl LogIndex {
    pub(super) const fn last(&self) -> u64 {
        self.last
    }

    /// Newest durable entry.
    pub(super) fn durable(&self) -> u64 {
        self.locations.len() as u64
    }

    pub(super) fn location(&self, index: u64) -> Option<Location> {
        self.locations.get(usize::try_from(index.checked_sub(1)?).ok()?).copied()
    }

    pub(super) fn term(&self, index: u64) -> Option<u64> {
        if index == 0 || index > self.last {
            return None;
        }
        let run = self.terms.partition_point(|(first, _)| *first <= index).checked_sub(1)?;
        self.terms.get(run).map(|(_, term)| *term)
    }

    /// Adds an entry, superseding what has its index or a higher one. `index` is at most one above the last.
    pub(super) fn append(&mut self, index: u64, term: u64) {
        let keep = usize::try_from(index.saturating_sub(1)).unwrap_or(usize::MAX);
        self.locations.truncate(keep);
        while self.terms.last().is_some_and(|(first, _)| *first >= index) {
            self.terms.pop();
        }
        if self.terms.last().is_none_or(|(_, last)| *last != term) {
            self.terms.push((index, term));
        }
        self.last = index;
    }

    /// Notes that entry `index` is durable. False if it is not the one after the newest durable entry.
    pub(super) fn place(&mut self, index: u64, location: Location) -> bool {
        let next = index == self.durable() + 1 && index <= self.last;
        if next {
            self.locations.push(location);
        }
        next
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_lower_index_supersedes_terms_and_locations() {
        let mut index = LogIndex::default();
        let location = Location { sequence: 1, offset: 96, bytes: 42 };
        for (entry, term) in [(1, 1), (2, 1), (3, 2), (4, 4)] {
            index.append(entry, term);
        }
        assert!(index.place(1, location) && index.place(2, location) && index.place(3, location));
        assert!(!index.place(5, location));
        assert_eq!([0, 1, 2, 3, 4, 5].map(|at| index.term(at)), [None, Some(1), Some(1), Some(2), Some(4), None]);
        index.append(2, 5);
        assert_eq!([1, 2, 3].map(|at| index.term(at)), [Some(1), Some(5), None]);
        assert_eq!((index.durable(), index.last()), (1, 2));
        assert_eq!(index.location(1).unwrap(), location);
        assert_eq!(index.location(2), None);
    }
}
