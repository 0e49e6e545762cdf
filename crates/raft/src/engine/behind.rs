//! Nodes that lack blocks which replication does not bring any more.
//!
//! The log of a leader begins where its old segments were dropped. A follower that needs what was before cannot be
//! served by Raft: there are no Raft snapshots. The leader says so ([`PeerMessage::Behind`]), the follower's driver
//! fetches blocks or a snapshot from any peer, and a new engine goes on from there ([`Engine::tell_what_is_held`]).

use super::Engine;
use crate::interface::Output;
use crate::message::{LogBegin, PeerMessage, RaftKind, RaftMessage};
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use raft::StateRole;
use raft::eraftpb::{Message, MessageType};

impl Engine {
    /// A leader's heartbeat has just gone out: who answers and needs what is not there any more, is told.
    ///
    /// The next entry to send points below the log only after that node has refused a later one, or after it was known
    /// to hold less.
    pub(super) fn tell_who_is_behind(&self, out: &mut Vec<Output>) {
        let raft = &self.raw.raft;
        if raft.state != StateRole::Leader || raft.heartbeat_elapsed() != 0 {
            return;
        }
        let first_index = self.store.first_index();
        let mut behind: Vec<u64> = raft
            .prs()
            .iter()
            .filter(|(node, progress)| {
                **node != self.config.id && progress.recent_active && progress.next_idx < first_index
            })
            .map(|(node, _)| *node)
            .collect();
        behind.sort_unstable();
        for to in behind {
            tracing::debug!(to, first_index, "a peer needs blocks that were dropped");
            out.push(Output::Send { to, message: PeerMessage::Behind(LogBegin { first_index }) });
        }
    }

    /// A peer says that its log begins at `first_index`. Believed of the leader only. Only committed entries count
    /// here: the entries after them may differ from the leader's.
    pub(super) fn told_behind(&self, from: u64, first_index: u64, out: &mut Vec<Output>) {
        let committed = self.raw.raft.raft_log.committed;
        if self.is_leader() || self.leader() != Some(from) || committed >= first_index.saturating_sub(1) {
            tracing::debug!(from, first_index, "a peer believes that this node is far behind, but it is not");
            return;
        }
        out.push(Output::Behind { from, first_index });
    }

    /// Does the leader of this term show a receipt for a block that this log does not hold? Then this node has lost blocks
    /// that it had acknowledged. Within a term nothing that was acknowledged is replaced (Raft §5.3, leader append-only), and
    /// nobody else can make the receipt.
    pub(super) fn has_lost_blocks(&self, message: &RaftMessage) -> Option<u64> {
        let (term, last) = (self.raw.raft.term, self.raw.raft.raft_log.last_index());
        let shown = message.kind == i32::from(RaftKind::Heartbeat) && self.receipts.show_loss(message, term, last);
        shown.then_some(message.receipt_index)
    }

    /// A learner has promised nothing to anybody and may fetch what it lost. A voter has helped to commit by keeping
    /// entries and a vote; without them its voice could elect a leader that lacks acknowledged blocks, so it stops.
    pub(super) fn stop_or_fetch(&mut self, from: u64, acknowledged: u64, out: &mut Vec<Output>) {
        let last = self.raw.raft.raft_log.last_index();
        if !self.membership.is_voter(self.config.id) {
            tracing::warn!(from, last, acknowledged, "this node has lost blocks that it had acknowledged");
            out.push(Output::Behind { from, first_index: acknowledged.saturating_add(1) });
            return;
        }
        let reason = Rejection::new(Code::DiskFailed, "this voter has lost blocks that it had acknowledged")
            .found(format!("log that ends at height {last}"))
            .wanted(format!("at least height {acknowledged}, of which node {from} shows this node's own receipt"))
            .next("ledgerd rejoin --config FILE: it comes back as a new node, because this one must not vote any more");
        self.fail(reason, out);
    }

    /// After a heartbeat that was accepted: the leader knows less of this node than is committed here, as after
    /// fetching blocks elsewhere. Saying so lets the leader go on behind them.
    ///
    /// Safe because what is committed is in the log of every later leader (Raft §5.4.3, leader completeness), and
    /// because only what is on this disk is named.
    pub(super) fn tell_what_is_held(&mut self, leader: u64, known: u64) {
        let raft = &mut self.raw.raft;
        let held = raft.raft_log.committed.min(raft.raft_log.persisted);
        let held = held + u64::from(active(Mutation::CatchUpOffByOne));
        if raft.state != StateRole::Follower || raft.leader_id != leader || known >= held {
            return;
        }
        let mut message = Message::default();
        message.set_msg_type(MessageType::MsgAppendResponse);
        (message.from, message.to, message.term) = (raft.id, leader, raft.term);
        (message.index, message.commit) = (held, held);
        raft.msgs.push(message);
    }
}
