//! The newest entries in memory: all that are not yet on disk, and of the others as many as the limit allows.

use std::collections::VecDeque;

use crate::entry::Entry;
use crate::segment::RECORD_HEADER_BYTES;

/// A gapless run of entries up to the newest.
#[derive(Debug)]
pub(super) struct Recent {
    entries: VecDeque<Entry>,
    bytes: usize,
    bytes_max: usize,
}

impl Recent {
    pub(super) const fn new(bytes_max: usize) -> Self {
        Self { entries: VecDeque::new(), bytes: 0, bytes_max }
    }

    pub(super) fn get(&self, index: u64) -> Option<&Entry> {
        let first = self.entries.front()?.index;
        self.entries.get(usize::try_from(index.checked_sub(first)?).ok()?)
    }

    /// The oldest entry held.
    pub(super) fn first(&self) -> Option<u64> {
        self.entries.front().map(|entry| entry.index)
    }

    /// Forgets the entries before `first`.
    pub(super) fn drop_before(&mut self, first: u64) {
        while let Some(oldest) = self.entries.front().filter(|oldest| oldest.index < first) {
            self.bytes -= weight(oldest);
            self.entries.pop_front();
        }
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.entries.clear();
        self.bytes = 0;
    }

    /// Adds the entry, superseding what has its index or a higher one.
    pub(super) fn append(&mut self, entry: Entry) {
        while let Some(last) = self.entries.back().filter(|last| last.index >= entry.index) {
            self.bytes -= weight(last);
            self.entries.pop_back();
        }
        self.bytes += weight(&entry);
        self.entries.push_back(entry);
    }

    /// Forgets the oldest entries while there is too much, but none above `durable`.
    pub(super) fn trim(&mut self, durable: u64) {
        while self.bytes > self.bytes_max {
            let Some(first) = self.entries.front().filter(|first| first.index <= durable) else { return };
            self.bytes -= weight(first);
            self.entries.pop_front();
        }
    }
}

/// The cost of an entry in memory, about.
pub(super) fn weight(entry: &Entry) -> usize {
    entry.data.len() + size_of::<Entry>() + RECORD_HEADER_BYTES
}
