//! Connects ordering with the subsystems that are built after it.

use crate::clients::rejections::Rejections;
use crate::ordering::directory::Directory;
use crate::ordering::orderer::Outlet;
use crate::ordering::reads::ReadIndex;
use crate::peers::Peers;
use ledger::Refusal;
use ledger_light::Misbehaviour;
use ledger_raft::{Contradiction, PeerMessage};
use ledger_replica::Known;
use std::sync::Arc;

/// Passes on what ordering hands out.
pub(super) struct ToSubsystems {
    /// Answers to readers.
    pub reads: ReadIndex,
    /// Messages to other nodes, and proofs of lies.
    pub peers: Arc<Peers>,
    /// The names of the nodes.
    pub directory: Arc<Directory>,
    /// Rejected calls.
    pub rejections: Arc<Rejections>,
}

impl Outlet for ToSubsystems {
    fn send(&self, to: u64, message: &PeerMessage) -> bool {
        self.peers.connections.send(to, message)
    }

    fn answered(&self, question: u64, answer: Known) {
        self.reads.answered(question, answer);
    }

    fn rejected(&self, now: u64, refusal: &Refusal) {
        self.rejections.record(now, refusal);
    }

    fn misbehaved(&self, proof: Box<Misbehaviour>) {
        self.peers.certificates.misbehaved(proof);
    }

    fn contradicted(&self, found: Contradiction) {
        self.peers.monitor.contradicted(&self.directory.name(found.node), &found);
    }
}
