//! Where the log begins: dropping what is old, and beginning anew after a snapshot.

use std::io::ErrorKind;
use std::sync::Arc;

use super::files::StoredSegment;
use super::lock::lock;
use super::oldest::Beginning;
use super::state::{Staged, State};
use super::writer::Failure;
use super::{Base, BlockStore, StoreError};
use crate::entry::HardState;
use ledger_base::invariant;

/// A segment that is finished: no entry is written to it any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finished {
    /// The index that follows the newest entry before it.
    pub first_index: u64,
    /// The index that follows the newest entry in it: [`BlockStore::prune`] drops it at this one.
    pub next_index: u64,
    /// Its size.
    pub bytes: u64,
}

impl BlockStore {
    /// The finished segments, the oldest first.
    pub fn finished(&self) -> Vec<Finished> {
        let state = self.state();
        let pairs = state.segments.iter().zip(state.segments.iter().skip(1));
        pairs
            .map(|(segment, next)| Finished {
                first_index: segment.first_index,
                next_index: next.first_index,
                bytes: next.bytes_before.into(),
            })
            .collect()
    }

    /// Drops whole segments, the oldest first, all of whose entries are below `keep_from`, committed and durable; never
    /// the one that is being written. Answers with the new first index, which may be the old one.
    ///
    /// A crash at any point leaves a log that begins somewhere between the old and the new first index. An error
    /// poisons the store, as one of a write does.
    pub fn prune(&self, keep_from: u64) -> Result<u64, StoreError> {
        let mut dropping = lock(&self.dropping);
        let (dropped, first, oldest) = {
            let mut state = self.state();
            state.writable()?;
            (state.drop_before(keep_from), state.index.base().index + 1, state.segments.front().cloned())
        };
        if let Some(oldest) = oldest {
            let place = Beginning { sequence: oldest.sequence, first_index: oldest.first_index };
            dropping.note(place).map_err(|error| self.state().poison(error))?;
        }
        for segment in dropped {
            self.remove(&segment)?;
            // One after the other, so that there is never a gap.
            self.sync_names()?;
        }
        Ok(first)
    }

    /// Makes the log empty, to go on after `base`, the newest block that a snapshot holds. Meant for a node that is
    /// behind: its orderer must not run.
    ///
    /// Term and vote are kept, so that no vote is given twice; everything up to `base` counts as committed. A crash
    /// leaves the old log or the new one; a log that goes on after `base` already is left as it is. A full disk leaves
    /// the old one and may be tried again; any other error poisons the store.
    ///
    /// # Errors
    /// [`StoreError::NotBehind`] if that would lose entries that this node may have helped to commit: the log has the
    /// block of the snapshot, or is committed up to it.
    pub fn begin_after(&self, base: Base) -> Result<(), StoreError> {
        let mut dropping = lock(&self.dropping);
        let mut writer = lock(&self.writer);
        let hard_state = {
            let state = self.state();
            state.writable()?;
            if state.index.base() == base {
                return Ok(());
            }
            state.check_behind(base)?;
            let HardState { term, vote, .. } = state.hard_state;
            HardState { term: term.max(base.term), vote: if term >= base.term { vote } else { 0 }, commit: base.index }
        };
        let segment = match writer.begin_after(base, hard_state, &self.ahead, &self.marks) {
            Ok(segment) => segment,
            Err(Failure::Undone(error)) => return Err(error),
            Err(Failure::Fatal(error)) => return Err(self.state().poison(error)),
        };
        drop(writer);
        let place = Beginning { sequence: segment.sequence, first_index: segment.first_index };
        dropping.note(place).map_err(|error| self.state().poison(error))?;
        for void in self.state().begin_after(base, hard_state, segment) {
            self.remove(&void)?;
        }
        self.sync_names()
    }

    fn remove(&self, segment: &StoredSegment) -> Result<(), StoreError> {
        self.files.close_before(segment.sequence + 1);
        let removed = match self.disk.remove(&segment.name) {
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
            removed => removed,
        };
        removed.map_err(|error| self.state().poison(StoreError::io("remove", &segment.name, error)))
    }

    fn sync_names(&self) -> Result<(), StoreError> {
        let synced = self.disk.sync_dir();
        synced.map_err(|error| self.state().poison(StoreError::io("sync the directory", ".", error)))
    }
}

impl State {
    /// Forgets the segments that may go. An entry in a segment never has the first index of the next one, or more.
    fn drop_before(&mut self, keep_from: u64) -> Vec<Arc<StoredSegment>> {
        let settled = self.committed.min(self.index.durable());
        let limit = keep_from.min(settled.saturating_add(1));
        let mut dropped = Vec::new();
        while self.segments.get(1).is_some_and(|next| next.first_index <= limit) {
            dropped.extend(self.segments.pop_front());
        }
        if let Some(oldest) = self.segments.front().filter(|_| !dropped.is_empty()) {
            let first = oldest.first_index;
            invariant!(first <= settled + 1, "dropped blocks are committed and durable", "up to {first}, of {settled}");
            self.index.drop_before(oldest.first_index, oldest.sequence);
            self.recent.drop_before(oldest.first_index);
        }
        dropped
    }

    fn check_behind(&self, base: Base) -> Result<(), StoreError> {
        let (first, last, committed) = (self.index.base().index + 1, self.index.last(), self.committed);
        if base.index > committed && self.index.term(base.index) != Some(base.term) {
            return Ok(());
        }
        Err(StoreError::NotBehind { index: base.index, term: base.term, first, last, committed })
    }

    /// Takes over a log that begins anew; answers with the segments that are void.
    fn begin_after(
        &mut self,
        base: Base,
        hard_state: HardState,
        segment: Arc<StoredSegment>,
    ) -> Vec<Arc<StoredSegment>> {
        let (before, after) = (self.hard_state.term, hard_state.term);
        invariant!(after >= before, "a log that begins anew keeps the term", "term {after} after {before}");
        let (base_index, committed) = (base.index, self.committed);
        invariant!(
            base_index >= committed,
            "a committed block stays",
            "a log after {base_index}, committed {committed}"
        );
        self.index = super::index::LogIndex::new(base);
        self.recent.clear();
        self.staged = Staged::default();
        self.superseded_from = u64::MAX;
        self.hard_state = hard_state;
        self.committed = base.index;
        std::mem::replace(&mut self.segments, [segment].into()).into()
    }
}
