//! The block store as the `raft` crate's log.

use crate::message::ENTRIES_MAX;
use crate::message::convert::entry_into_raft;
use ledger::members::Membership;
use ledger_storage::block_store::{BlockStore, StoreError};
use raft::eraftpb::{ConfState, Entry, HardState, Snapshot};
use raft::{GetEntriesContext, RaftState, Result, Storage, StorageError};
use std::sync::Arc;

/// Entries in one reply to the crate. Half of what a message may hold, so that what is not yet in the store still
/// fits beside it.
const ENTRIES_PER_READ: u64 = ENTRIES_MAX as u64 / 2;

/// The log of one node: a view of its block store, and what the crate asks for once at the start.
pub(crate) struct Log {
    store: Arc<BlockStore>,
    state: RaftState,
}

impl Log {
    /// `applied` is the last height that the state machine holds. It is committed, whatever the hard state says: the
    /// commit index is not flushed for its own sake and may lag behind. So is what came before a log that was cut off.
    ///
    /// Blocks that were fetched from a peer may be of a term that this node never heard of: then it has not voted in
    /// it.
    pub(crate) fn new(store: Arc<BlockStore>, members: &Membership, applied: u64) -> Self {
        let stored = store.hard_state();
        let newest = store.term(store.last_index()).unwrap_or(0);
        let hard_state = HardState {
            term: stored.term.max(newest),
            vote: if stored.term >= newest { stored.vote } else { raft::INVALID_ID },
            commit: stored.commit.max(applied).max(store.first_index().saturating_sub(1)),
            ..HardState::default()
        };
        let state = RaftState { hard_state, conf_state: conf_state(members) };
        Self { store, state }
    }

    fn unavailable(index: u64, error: Option<StoreError>) -> raft::Error {
        match error {
            Some(error) => StorageError::Other(Box::new(error)).into(),
            None => {
                tracing::error!(index, "entry missing in the block store");
                StorageError::Unavailable.into()
            }
        }
    }
}

impl Storage for Log {
    fn initial_state(&self) -> Result<RaftState> {
        Ok(self.state.clone())
    }

    /// The crate asks for three reasons, told apart by its arguments:
    /// - to send them (`can_async`): whole entries;
    /// - to hand out committed ones (a size limit): we read those from the store ourselves, see `engine/pump.rs`, so
    ///   index and term are enough;
    /// - to look for changes of members before an election (no size limit): the kind is needed, the data is not.
    ///
    /// Old segments may be dropped by another thread at any moment. An entry that was dropped is `Compacted`, and never
    /// a gap.
    fn entries(
        &self,
        low: u64,
        high: u64,
        max_size: impl Into<Option<u64>>,
        context: GetEntriesContext,
    ) -> Result<Vec<Entry>> {
        if low < self.store.first_index() {
            return Err(StorageError::Compacted.into());
        }
        match (context.can_async(), max_size.into()) {
            (true, max_size) => {
                let high = high.min(low.saturating_add(ENTRIES_PER_READ));
                let bytes = max_size.map_or(usize::MAX, |bytes| usize::try_from(bytes).unwrap_or(usize::MAX));
                match self.store.entries(low..high, bytes) {
                    Ok(entries) if entries.first().is_none_or(|first| first.index != low) => {
                        Err(StorageError::Compacted.into())
                    }
                    Ok(entries) => Ok(entries.into_iter().map(entry_into_raft).collect()),
                    Err(error) => {
                        // A peer that needs damaged old blocks must not bring down the leader: it serves the others.
                        tracing::error!(low, high, %error, "cannot read blocks that a peer needs");
                        Err(StorageError::LogTemporarilyUnavailable.into())
                    }
                }
            }
            (false, Some(_)) => {
                let high = high.min(low.saturating_add(ENTRIES_PER_READ));
                (low..high).map(|index| Ok(Entry { index, term: self.term(index)?, ..Entry::default() })).collect()
            }
            (false, None) => (low..high)
                .map(|index| match self.store.entry(index) {
                    Ok(Some(mut entry)) => {
                        entry.data = bytes::Bytes::new();
                        Ok(entry_into_raft(entry))
                    }
                    Ok(None) => Err(Self::unavailable(index, None)),
                    Err(error) => Err(Self::unavailable(index, Some(error))),
                })
                .collect(),
        }
    }

    /// An entry that was cut off has term 0, as the crate has it (`RaftLog::term`). It asks in two steps, between which
    /// old segments may be dropped, and fails on `Compacted` in the second (`handle_append_entries`).
    fn term(&self, index: u64) -> Result<u64> {
        match self.store.term(index) {
            Some(term) => Ok(term),
            None if index < self.store.first_index() => Ok(0),
            None => Err(StorageError::Unavailable.into()),
        }
    }

    fn first_index(&self) -> Result<u64> {
        Ok(self.store.first_index())
    }

    fn last_index(&self) -> Result<u64> {
        Ok(self.store.last_index())
    }

    /// Asked for when a peer needs blocks that were dropped. It is told so (`engine/behind.rs`) and fetches them
    /// itself: the crate knows of no snapshot, so `ProgressState::Snapshot` never happens.
    fn snapshot(&self, _request_index: u64, _to: u64) -> Result<Snapshot> {
        Err(StorageError::SnapshotTemporarilyUnavailable.into())
    }
}

/// The members as the crate wants them.
pub(crate) fn conf_state(members: &Membership) -> ConfState {
    let mut state = ConfState::default();
    state.set_voters(members.voters.iter().copied().collect());
    state.set_learners(members.learners.iter().copied().collect());
    state.set_voters_outgoing(members.outgoing.iter().copied().collect());
    state.set_learners_next(members.learners_next.iter().copied().collect());
    state.auto_leave = members.auto_leave;
    state
}

/// The members as the crate has them.
pub(crate) fn membership(state: &ConfState) -> Membership {
    Membership {
        voters: state.get_voters().iter().copied().collect(),
        learners: state.get_learners().iter().copied().collect(),
        outgoing: state.get_voters_outgoing().iter().copied().collect(),
        learners_next: state.get_learners_next().iter().copied().collect(),
        auto_leave: state.auto_leave,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::convert::change_into_raft;
    use ledger::members::{Change, MembershipChange};
    use proptest::prelude::*;
    use raft::{Changer, ProgressTracker};

    /// The crate's own answer to a change: what `Raft::apply_conf_change` does.
    fn by_the_crate(tracker: &mut ProgressTracker, change: &MembershipChange) -> bool {
        let change = change_into_raft(change);
        let mut changer = Changer::new(tracker);
        let result = if change.leave_joint() {
            changer.leave_joint()
        } else if let Some(auto_leave) = change.enter_joint() {
            changer.enter_joint(auto_leave, change.get_changes())
        } else {
            changer.simple(change.get_changes())
        };
        let Ok((configuration, changes)) = result else { return false };
        tracker.apply_conf(configuration, changes, 1);
        true
    }

    fn changes() -> impl Strategy<Value = MembershipChange> {
        let change = (0..3, 1..6u64).prop_map(|(kind, node)| match kind {
            0 => Change::AddVoter(node),
            1 => Change::AddLearner(node),
            _ => Change::Remove(node),
        });
        (0..3u32, prop::collection::vec(change, 0..4)).prop_map(|(transition, changes)| {
            let mut change = MembershipChange::new(changes);
            change.transition = if change.changes.is_empty() { 0 } else { transition };
            change
        })
    }

    proptest! {
        #[test]
        fn our_rules_for_members_are_those_of_the_crate(changes in prop::collection::vec(changes(), 1..20)) {
            let mut ours = Membership::new([1, 2, 3], [4]);
            let mut tracker = ProgressTracker::new(8);
            raft_restore(&mut tracker, &ours);
            for change in changes {
                let next = ours.apply(&change);
                prop_assert_eq!(next.is_ok(), by_the_crate(&mut tracker, &change), "{:?} on {:?}", change, ours);
                ours = next.unwrap_or(ours);
                prop_assert_eq!(&membership(&tracker.conf().to_conf_state()), &ours);
            }
        }
    }

    fn raft_restore(tracker: &mut ProgressTracker, members: &Membership) {
        let voters = members.voters.iter().map(|node| Change::AddVoter(*node));
        let learners = members.learners.iter().map(|node| Change::AddLearner(*node));
        for change in voters.chain(learners) {
            assert!(by_the_crate(tracker, &MembershipChange::new([change])));
        }
    }
}
