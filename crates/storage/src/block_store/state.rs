//! The log as memory knows it: the view of readers, and the rules of appending.

use std::collections::VecDeque;
use std::sync::Arc;

use super::files::StoredSegment;
use super::index::LogIndex;
use super::recent::{Recent, weight};
use super::recovery::{check_entry, check_hard_state};
use super::writer::{Placed, Written};
use super::{STAGED_BYTES_MAX, StoreError};
use crate::entry::{Entry, HardState};
use crate::segment::ENTRY_BYTES_MAX;
use ledger_base::invariant;

pub(super) struct State {
    pub(super) index: LogIndex,
    pub(super) recent: Recent,
    pub(super) staged: Staged,
    /// Of what is being written, entries from this index on have been superseded since. `u64::MAX`: none.
    pub(super) superseded_from: u64,
    pub(super) hard_state: HardState,
    pub(super) committed: u64,
    /// All segments, with gapless sequence numbers.
    pub(super) segments: VecDeque<Arc<StoredSegment>>,
    /// The error that ended writing.
    pub(super) poison: Option<StoreError>,
}

/// Bytes that wait for the disk. Entries are gapless and none is superseded.
#[derive(Default)]
pub(super) struct Staged {
    pub(super) entries: Vec<Entry>,
    /// Written after the entries, so that it never calls committed what is not there.
    pub(super) hard_state: Option<HardState>,
    pub(super) bytes: usize,
}

impl State {
    pub(super) fn writable(&self) -> Result<(), StoreError> {
        self.poison.clone().map_or(Ok(()), Err)
    }

    /// Ends writing; returns the error that did so first.
    pub(super) fn poison(&mut self, error: StoreError) -> StoreError {
        self.poison.get_or_insert(error).clone()
    }

    /// Faults of a caller that do no harm.
    pub(super) fn check_limits(&self, entries: &[Entry]) -> Result<(), StoreError> {
        let mut wanted = self.index.last() + 1;
        let mut bytes = self.staged.bytes;
        for (place, entry) in entries.iter().enumerate() {
            let starts = place == 0 && (self.index.base().index + 1..=wanted).contains(&entry.index);
            if !starts && entry.index != wanted {
                return Err(StoreError::Gap { found: entry.index, wanted });
            }
            wanted = entry.index.saturating_add(1);
            let found_bytes = entry.data.len();
            if found_bytes > ENTRY_BYTES_MAX {
                return Err(StoreError::TooLarge { index: entry.index, found_bytes, max_bytes: ENTRY_BYTES_MAX });
            }
            bytes = bytes.saturating_add(weight(entry));
        }
        if bytes > STAGED_BYTES_MAX && !entries.is_empty() {
            return Err(StoreError::StageFull { staged_bytes: bytes, max_bytes: STAGED_BYTES_MAX });
        }
        Ok(())
    }

    /// Faults that only a broken orderer has.
    pub(super) fn check_rules(&self, entries: &[Entry], hard_state: Option<&HardState>) -> Result<(), String> {
        if let Some(first) = entries.first() {
            check_entry(&self.index, first.index, first.term, self.committed)?;
        }
        for pair in entries.windows(2) {
            if let [before, after] = pair
                && after.term < before.term
            {
                return Err(format!("entry {} has term {}, the one before {}", after.index, after.term, before.term));
            }
        }
        let last = entries.last().map_or(self.index.last(), |entry| entry.index);
        let Some(new) = hard_state else { return Ok(()) };
        check_hard_state(&self.hard_state, new, last)?;
        self.check_promises(new)
    }

    /// A vote is given once in a term, and what is committed stays so. An orderer that does otherwise forgets what it has
    /// promised to others.
    fn check_promises(&self, new: &HardState) -> Result<(), String> {
        let HardState { term, vote, commit } = self.hard_state;
        if new.term == term && vote != 0 && new.vote != vote {
            return Err(format!("a vote for {} follows one for {vote} in term {term}", new.vote));
        }
        if new.commit < commit {
            return Err(format!("the hard state marks {} as committed, the one before {commit}", new.commit));
        }
        Ok(())
    }

    pub(super) fn stage(&mut self, entry: Entry) {
        self.superseded_from =
            if entry.index <= self.index.last() { self.superseded_from.min(entry.index) } else { self.superseded_from };
        let (index, last) = (entry.index, self.index.last());
        invariant!(index <= last + 1, "the log has no gap", "block {index} after {last}");
        let committed = self.committed;
        invariant!(index > committed, "a committed block is not superseded", "block {index}, committed {committed}");
        self.index.append(entry.index, entry.term);
        self.recent.append(entry.clone());
        self.staged.push(entry);
    }

    /// Notes where entries are that became durable.
    pub(super) fn complete(&mut self, written: Written) -> Result<(), String> {
        self.segments.extend(written.segments);
        for Placed { index, position, .. } in written.entries {
            if index >= self.superseded_from {
                self.index.pass(index);
            } else if !self.index.place(index, position) {
                return Err(format!("entry {index} was written, the log on disk ended at {}", self.index.durable()));
            }
        }
        let (durable, last) = (self.index.durable(), self.index.last());
        invariant!(durable <= last, "durable blocks were written", "block {durable}, the log ends at {last}");
        self.recent.trim(durable);
        Ok(())
    }

    /// Takes back what could not be written: all but the first `placed` entries.
    pub(super) fn restage(&mut self, staged: Staged, placed: usize) {
        let since = std::mem::take(&mut self.staged);
        let kept = staged.entries.into_iter().skip(placed).filter(|entry| entry.index < self.superseded_from);
        for entry in kept.collect::<Vec<_>>().into_iter().chain(since.entries) {
            self.staged.push(entry);
        }
        self.staged.hard_state = since.hard_state.or(staged.hard_state);
    }

    pub(super) fn segment(&self, sequence: u32) -> Option<&Arc<StoredSegment>> {
        let place = sequence.checked_sub(self.segments.front()?.sequence)?;
        self.segments.get(usize::try_from(place).ok()?)
    }
}

impl Staged {
    pub(super) const fn is_empty(&self) -> bool {
        self.entries.is_empty() && self.hard_state.is_none()
    }

    /// Adds an entry; those it supersedes never need to be written.
    pub(super) fn push(&mut self, entry: Entry) {
        while let Some(last) = self.entries.last().filter(|last| last.index >= entry.index) {
            self.bytes -= weight(last);
            self.entries.pop();
        }
        self.bytes += weight(&entry);
        self.entries.push(entry);
    }
}
