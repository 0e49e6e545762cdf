//! Transfers of leadership: a voter stands for election in spite of the leader's lease only with the leader's signed word.
//!
//! ```text
//! timeout now   from the leader, with its signature over term, leader and transferee
//! vote          of the transferee, with that signature; context `CampaignTransfer`
//! voter         honours the context if the leader that it follows has signed
//! ```
//! Without it the context is removed: the request is one like any other, and the lease of a leader that lives counts. So
//! no voter takes the leadership at will. A pre-vote never has the context: a transferee asks for votes at once.

use super::Engine;
use super::mandate::Handover;
use crate::message::{RaftKind, RaftMessage};
use bytes::Bytes;
use ledger_base::mutation::{Mutation, active};
use raft::CAMPAIGN_TRANSFER;

impl Engine {
    /// Signs the message by which this leader hands over. A transferee puts the word of its leader into its requests for votes.
    pub(super) fn attach_handover(&self, to: u64, message: &mut RaftMessage) {
        let (me, term) = (self.config.id, message.term);
        if message.kind == i32::from(RaftKind::TimeoutNow) {
            match self.mandates.ballots().sign_handover(Handover { term, leader: me, to }) {
                Ok(signed) => message.transfer = signed,
                Err(reason) => {
                    tracing::warn!(code = reason.code.name(), %reason, to, "cannot sign a leadership transfer")
                }
            }
        }
        if message.kind == i32::from(RaftKind::Vote)
            && message.context[..] == *CAMPAIGN_TRANSFER
            && let Some((led, signed)) = &self.handed_over
            && led + 1 == term
        {
            message.transfer = signed.clone();
        }
    }

    /// The leader hands over to this node: its word is kept for the voters.
    pub(super) fn take_handover(&mut self, from: u64, message: &RaftMessage) -> Result<(), &'static str> {
        self.check_handover(from, self.config.id, message)?;
        self.handed_over = Some((message.term, message.transfer.clone()));
        Ok(())
    }

    /// Takes the claim of a transfer from a request for a vote that does not have the word of the leader.
    pub(super) fn check_transfer(&mut self, from: u64, message: &mut RaftMessage) {
        if message.context[..] != *CAMPAIGN_TRANSFER {
            return;
        }
        let raft = &self.raw.raft;
        let (leader, transferee) = (raft.leader_id, raft.lead_transferee);
        let honoured = message.kind == i32::from(RaftKind::Vote)
            && ((self.is_leader() && transferee == Some(from))
                || (leader != raft::INVALID_ID && self.check_handover(leader, from, message).is_ok()));
        if !honoured && !active(Mutation::HonourAnyTransfer) {
            message.context = Bytes::new();
        }
    }

    /// Has the leader of this term signed that it hands over to that node?
    fn check_handover(&mut self, leader: u64, to: u64, message: &RaftMessage) -> Result<(), &'static str> {
        if message.transfer.is_empty() {
            return Err("it hands over without its signature");
        }
        self.hear_proof(to)?;
        let handover = Handover { term: self.raw.raft.term, leader, to };
        self.mandates.ballots().check_handover(handover, &message.transfer, self.now).map_err(|reason| {
            tracing::warn!(leader, to, code = reason.code.name(), %reason, "leadership transfer rejected");
            self.mandates.doubt(to, self.ticks);
            "it hands over without its signature"
        })
    }
}
