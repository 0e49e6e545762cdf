//! Connects ordering with the subsystems that are built after it.

use crate::clients::rejections::Rejections;
use crate::ordering::orderer::Outlet;
use crate::ordering::reads::ReadIndex;
use crate::peers::connections::Peers;
use crate::peers::quorum_certificates::Certificates;
use ledger::Refusal;
use ledger_light::DoubleVote;
use ledger_raft::PeerMessage;
use ledger_replica::Known;
use std::sync::Arc;

/// Passes on what ordering hands out.
pub(super) struct ToSubsystems {
    /// Messages to other nodes.
    pub peers: Arc<Peers>,
    /// Answers to readers.
    pub reads: ReadIndex,
    /// Rejected calls.
    pub rejections: Arc<Rejections>,
    /// Proofs of lies.
    pub certificates: Arc<Certificates>,
}

impl Outlet for ToSubsystems {
    fn send(&self, to: u64, message: &PeerMessage) -> bool {
        self.peers.send(to, message)
    }

    fn answered(&self, question: u64, answer: Known) {
        self.reads.answered(question, answer);
    }

    fn rejected(&self, now: u64, refusal: &Refusal) {
        self.rejections.record(now, refusal);
    }

    fn voted_twice(&self, proof: Box<DoubleVote>) {
        self.certificates.voted_twice(proof);
    }
}
