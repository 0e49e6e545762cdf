//! The voters and learners: a pure function of the committed changes.
//!
//! The rules are those of joint consensus as the engine implements them; a test holds the two together. Keeping
//! them here as well lets a node recover its members from the log, and refuse an impossible change before it is
//! ordered.

use bytes::Bytes;
use ledger_storage::entry::{Entry, EntryKind};
use prost::Message as _;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Most nodes that one change may name. Bounds what a hostile change costs.
pub const NODES_MAX: usize = 64;
/// Longest encoding of a change: every node with its id, and a context.
const CHANGE_BYTES_MAX: usize = 4096;

/// One step of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Change {
    /// Makes the node a voter, be it new or a learner.
    AddVoter(u64),
    /// Makes the node a learner, be it new or a voter.
    AddLearner(u64),
    /// Takes the node out.
    Remove(u64),
}

/// The data of a `ConfChangeV2` entry. A single change applies at once. Several go through a joint configuration, where
/// old and new majority are both needed; the leader leaves it by itself with an entry of empty data.
///
/// ```text
/// message MembershipChange { uint32 transition = 1; repeated Single changes = 2; bytes context = 3; }
/// message Single           { uint32 kind = 1; uint64 node = 2; }    // kind: 0 voter, 1 remove, 2 learner
/// ```
/// `transition`: 0 joint if several, 1 always joint, left by the leader, 2 always joint, left by a change without
/// content. The numbers are those of the engine, so that it can read what it proposes itself.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct MembershipChange {
    #[prost(uint32, tag = "1")]
    /// See above.
    pub transition: u32,
    #[prost(message, repeated, tag = "2")]
    /// See above.
    pub changes: Vec<Single>,
    /// Free for the caller, at most 1 KiB; comes back in the committed entry.
    #[prost(bytes = "bytes", tag = "3")]
    pub context: Bytes,
}

/// One change as it is encoded.
#[derive(Clone, Copy, PartialEq, Eq, prost::Message)]
pub struct Single {
    /// 0 voter, 1 remove, 2 learner.
    #[prost(uint32, tag = "1")]
    pub kind: u32,
    /// The node; never 0.
    #[prost(uint64, tag = "2")]
    pub node: u64,
}

/// Why a change is impossible.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MembershipError {
    /// The bytes are no change.
    #[error("change of members cannot be read: {0}")]
    Malformed(String),
    /// Too much at once.
    #[error("change of members is too large: found {found} {unit}, wanted at most {max}")]
    TooLarge {
        /// How many.
        found: usize,
        /// How many are allowed.
        max: usize,
        /// Of what.
        unit: &'static str,
    },
    /// Another change is under way.
    #[error("members are still changing; wait until the previous change is complete")]
    Joint,
    /// There is nothing to leave.
    #[error("change of members is empty, and no previous change is under way")]
    NotJoint,
    /// Nobody could order any more.
    #[error("change of members removes the last voter; add another voter first")]
    NoVoters,
    /// A simple change touched several voters.
    #[error("change of members touches {0} voters in one step, wanted at most one")]
    ManyVoters(usize),
}

/// Can any one of these voters be lost while certificates are strict? `hands` says under which hand each node is.
pub fn spare_one(voters: &BTreeSet<u64>, hands: &BTreeMap<u64, String>) -> bool {
    let mut counts = BTreeMap::<&str, usize>::new();
    for hand in voters.iter().filter_map(|voter| hands.get(voter)) {
        *counts.entry(hand).or_default() += 1;
    }
    let largest = counts.into_values().max().unwrap_or_default();
    ledger_light::strict_quorum(voters.len(), largest) < voters.len()
}

/// The members of a network.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Membership {
    /// The voters.
    pub voters: BTreeSet<u64>,
    /// The learners.
    pub learners: BTreeSet<u64>,
    /// The voters before a change that is under way; while not empty, their majority is needed too.
    pub outgoing: BTreeSet<u64>,
    /// Voters that will be learners once the change is complete; they still vote in `outgoing`.
    pub learners_next: BTreeSet<u64>,
    /// The leader completes the change by itself.
    pub auto_leave: bool,
}

impl MembershipChange {
    /// A change of one or several members.
    pub fn new(changes: impl IntoIterator<Item = Change>) -> Self {
        let changes = changes
            .into_iter()
            .map(|change| match change {
                Change::AddVoter(node) => Single { kind: 0, node },
                Change::Remove(node) => Single { kind: 1, node },
                Change::AddLearner(node) => Single { kind: 2, node },
            })
            .collect();
        Self { transition: 0, changes, context: Bytes::new() }
    }

    /// The steps, in order.
    pub fn changes(&self) -> impl Iterator<Item = Change> + '_ {
        self.changes.iter().filter_map(|single| match single.kind {
            0 => Some(Change::AddVoter(single.node)),
            1 => Some(Change::Remove(single.node)),
            2 => Some(Change::AddLearner(single.node)),
            _ => None,
        })
    }

    /// The data of the entry.
    pub fn to_bytes(&self) -> Bytes {
        self.encode_to_vec().into()
    }

    /// Reads the data of an entry; empty data completes a joint change.
    ///
    /// # Errors
    /// [`MembershipError::Malformed`] and [`MembershipError::TooLarge`]. Every node treats such an entry as no change.
    pub fn from_bytes(data: &[u8]) -> Result<Self, MembershipError> {
        let too_large = |found, max, unit| Err(MembershipError::TooLarge { found, max, unit });
        if data.len() > CHANGE_BYTES_MAX {
            return too_large(data.len(), CHANGE_BYTES_MAX, "bytes");
        }
        let change = Self::decode(data).map_err(|error| MembershipError::Malformed(error.to_string()))?;
        if change.changes.len() > NODES_MAX {
            return too_large(change.changes.len(), NODES_MAX, "nodes");
        }
        if change.transition > 2 || change.changes.iter().any(|single| single.kind > 2 || single.node == 0) {
            return Err(MembershipError::Malformed("unknown kind of change, or node 0".to_owned()));
        }
        Ok(change)
    }

    fn leaves_joint(&self) -> bool {
        self.transition == 0 && self.changes.is_empty()
    }

    fn is_joint(&self) -> bool {
        self.transition != 0 || self.changes.len() > 1
    }
}

impl Membership {
    /// The members of a genesis.
    pub fn new(voters: impl IntoIterator<Item = u64>, learners: impl IntoIterator<Item = u64>) -> Self {
        Self { voters: voters.into_iter().collect(), learners: learners.into_iter().collect(), ..Self::default() }
    }

    /// A change is under way.
    pub fn is_joint(&self) -> bool {
        !self.outgoing.is_empty()
    }

    /// The node's vote counts.
    pub fn is_voter(&self, node: u64) -> bool {
        self.voters.contains(&node) || self.outgoing.contains(&node)
    }

    /// The node receives blocks.
    pub fn contains(&self, node: u64) -> bool {
        self.is_voter(node) || self.learners.contains(&node)
    }

    /// Every node, in ascending order.
    pub fn nodes(&self) -> BTreeSet<u64> {
        self.voters.iter().chain(&self.learners).chain(&self.outgoing).copied().collect()
    }

    /// The node is the only one whose vote is needed.
    pub fn is_alone(&self, node: u64) -> bool {
        !self.is_joint() && self.voters.len() == 1 && self.voters.contains(&node)
    }

    /// The members after a change.
    ///
    /// # Errors
    /// When the change is impossible from here. Every node then keeps the members as they were.
    pub fn apply(&self, change: &MembershipChange) -> Result<Self, MembershipError> {
        let mut next = self.clone();
        if change.leaves_joint() {
            if !self.is_joint() {
                return Err(MembershipError::NotJoint);
            }
            next.learners.append(&mut next.learners_next);
            next.outgoing.clear();
            next.auto_leave = false;
            return Ok(next);
        }
        if self.is_joint() {
            return Err(MembershipError::Joint);
        }
        if change.is_joint() {
            if self.voters.is_empty() {
                return Err(MembershipError::NoVoters);
            }
            next.outgoing = self.voters.clone();
            next.auto_leave = change.transition != 2;
        }
        change.changes().for_each(|change| next.apply_one(change));
        if next.voters.is_empty() {
            return Err(MembershipError::NoVoters);
        }
        let changed = next.voters.symmetric_difference(&self.voters).count();
        if !change.is_joint() && changed > 1 {
            return Err(MembershipError::ManyVoters(changed));
        }
        Ok(next)
    }

    fn apply_one(&mut self, change: Change) {
        match change {
            Change::AddVoter(node) => {
                self.learners.remove(&node);
                self.learners_next.remove(&node);
                self.voters.insert(node);
            }
            Change::AddLearner(node) => {
                self.voters.remove(&node);
                let set = if self.outgoing.contains(&node) { &mut self.learners_next } else { &mut self.learners };
                set.insert(node);
            }
            Change::Remove(node) => {
                self.voters.remove(&node);
                self.learners.remove(&node);
                self.learners_next.remove(&node);
            }
        }
    }

    /// The members after these committed entries: what is no change, or an impossible one, changes nothing.
    #[must_use]
    pub fn fold<'a>(self, entries: impl IntoIterator<Item = &'a Entry>) -> Self {
        entries.into_iter().fold(self, |members, entry| members.after(entry).unwrap_or(members))
    }

    /// The members after this entry, if it is a change and possible.
    pub fn after(&self, entry: &Entry) -> Option<Self> {
        if entry.kind != EntryKind::ConfChangeV2 {
            return None;
        }
        let change = MembershipChange::from_bytes(&entry.data);
        match change.and_then(|change| self.apply(&change)) {
            Ok(next) => Some(next),
            Err(error) => {
                tracing::warn!(height = entry.index, %error, "change of members has no effect");
                None
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn entry(change: &MembershipChange) -> Entry {
        Entry { index: 1, term: 1, kind: EntryKind::ConfChangeV2, data: change.to_bytes() }
    }

    #[test]
    fn one_change_applies_at_once_and_several_go_through_a_joint_configuration() {
        let start = Membership::new([1], [2]);
        let promoted = start.apply(&MembershipChange::new([Change::AddVoter(2)])).unwrap();
        assert_eq!(promoted, Membership::new([1, 2], []));
        let swap = MembershipChange::new([Change::AddVoter(3), Change::AddLearner(1)]);
        let joint = promoted.apply(&swap).unwrap();
        assert!(joint.is_joint() && joint.auto_leave && joint.is_voter(1));
        assert_eq!(joint.apply(&swap), Err(MembershipError::Joint));
        assert_eq!(joint.apply(&MembershipChange::default()).unwrap(), Membership::new([2, 3], [1]));
    }

    #[test]
    fn an_impossible_or_unreadable_change_changes_nothing() {
        let start = Membership::new([1], [2]);
        let last = entry(&MembershipChange::new([Change::Remove(1)]));
        let leave = entry(&MembershipChange::default());
        let garbage = Entry { data: Bytes::from_static(b"\xff\xff\xff"), ..last.clone() };
        let block = Entry { kind: EntryKind::Normal, ..entry(&MembershipChange::new([Change::AddVoter(9)])) };
        let node_zero = entry(&MembershipChange::new([Change::AddVoter(0)]));
        assert_eq!(start.clone().fold(&[last, leave, garbage, block, node_zero]), start);
    }

    #[test]
    fn a_change_round_trips_and_is_bounded() {
        let change = MembershipChange::new((1..=NODES_MAX as u64).map(Change::AddLearner));
        assert_eq!(MembershipChange::from_bytes(&change.to_bytes()).unwrap(), change);
        let many = MembershipChange::new((0..=NODES_MAX as u64).map(Change::AddLearner));
        assert!(matches!(MembershipChange::from_bytes(&many.to_bytes()), Err(MembershipError::TooLarge { .. })));
        let long = vec![0; CHANGE_BYTES_MAX + 1];
        assert!(matches!(MembershipChange::from_bytes(&long), Err(MembershipError::TooLarge { .. })));
    }
}
