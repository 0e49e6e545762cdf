//! How an engine stands.

use super::{Engine, Receipt};
use crate::interface::RoleChange;
use crate::queue::QueueStatus;
use ledger::members::Membership;
use raft::{ProgressState, StateRole};
use std::collections::BTreeSet;

impl Engine {
    /// How things stand.
    pub fn status(&self) -> Status {
        let raft = &self.raw.raft;
        let replication = |state| match state {
            ProgressState::Probe => Replication::Probing,
            ProgressState::Replicate => Replication::Streaming,
            ProgressState::Snapshot => Replication::Snapshot,
        };
        let mut peers: Vec<_> = match raft.state {
            StateRole::Leader => raft
                .prs()
                .iter()
                .filter(|(node, _)| **node != self.config.id)
                .map(|(node, progress)| PeerStatus {
                    node: *node,
                    matched: progress.matched,
                    next: progress.next_idx,
                    replication: replication(progress.state),
                    recently_active: self.is_active(*node),
                    receipt: self.receipts.given(*node),
                })
                .collect(),
            _ => Vec::new(),
        };
        peers.sort_by_key(|peer| peer.node);
        let (depositions, deposed) = self.depositions();
        Status {
            id: self.config.id,
            role: self.told,
            commit: raft.raft_log.committed,
            applied: self.applied,
            persisted: raft.raft_log.persisted,
            last: raft.raft_log.last_index(),
            may_propose: self.may_propose(),
            changing: self.membership.is_joint() || raft.has_pending_conf(),
            transferring_to: raft.lead_transferee,
            transfer_rests: self.transfer_rest > 0,
            first: self.store.first_index(),
            membership: self.membership.clone(),
            peers,
            control: self.queues.control.status(),
            data: self.queues.data.status(),
            depositions,
            excluded: self.mandates.excluded().clone(),
            deposed,
        }
    }
}

/// How an engine stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// This node.
    pub id: u64,
    /// The leader, the term, and the role of this node.
    pub role: RoleChange,
    /// Last height known to be committed.
    pub commit: u64,
    /// Last height executed.
    pub applied: u64,
    /// Last height on the own disk.
    pub persisted: u64,
    /// Last height of the log.
    pub last: u64,
    /// It leads and has executed everything that was there when it was elected.
    pub may_propose: bool,
    /// A change of members may be under way: the next one must wait.
    pub changing: bool,
    /// The voter that a leader is handing over to. Cleared when that has failed.
    pub transferring_to: Option<u64>,
    /// A transfer was tried not long ago; nobody but an operator should ask for the next one.
    pub transfer_rests: bool,
    /// First height of the log; `last + 1` if it is empty.
    pub first: u64,
    /// The members as of the last height handed out.
    pub membership: Membership,
    /// The others, as a leader sees them; empty elsewhere. In order of node.
    pub peers: Vec<PeerStatus>,
    /// The control lane.
    pub control: QueueStatus,
    /// The data lane.
    pub data: QueueStatus,
    /// The nodes that have lied, by proof.
    pub excluded: BTreeSet<u64>,
    /// How often complaints of voters have deposed a leader since the start of this engine.
    pub depositions: u64,
    /// The leaders that were deposed within the last 18000 election timeouts (an hour by default).
    pub deposed: Vec<Deposition>,
}

/// A leader that voters have deposed by their complaints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Deposition {
    /// The leader.
    pub leader: u64,
    /// How often, with less than an hour between two times.
    pub times: u32,
    /// When the last one was, by the clock that goes with inputs, microseconds.
    pub time: u64,
}

/// One peer as the leader sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PeerStatus {
    /// The peer.
    pub node: u64,
    /// Its log is known to be equal up to here.
    pub matched: u64,
    /// The next height it will be sent.
    pub next: u64,
    /// How entries are sent to it.
    pub replication: Replication,
    /// It was heard of within the last (shortest) election timeout.
    pub recently_active: bool,
    /// Its newest receipt of this term.
    pub receipt: Option<Receipt>,
}

/// How entries are sent to a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Replication {
    /// One message at a time, to find where its log ends.
    Probing,
    /// As they come.
    Streaming,
    /// It needs blocks that the log does not hold any more.
    Snapshot,
}
