//! Interface from ordering to the later subsystems.

use ledger::Refusal;
use ledger_light::Misbehaviour;
use ledger_raft::{Contradiction, PeerMessage};
use ledger_replica::Known;

/// Receives what ordering hands to other parts of the node. Called by the order thread: nothing here may block.
pub(crate) trait Outlet: Send + Sync {
    /// Sends a message to another node; false if it was dropped.
    fn send(&self, to: u64, message: &PeerMessage) -> bool;
    /// The answer to a question whether the state is current.
    fn answered(&self, question: u64, answer: Known);
    /// Ordering rejected a call, at this time of the node.
    fn rejected(&self, now: u64, refusal: &Refusal);
    /// A node has signed two different things for one place.
    fn misbehaved(&self, proof: Box<Misbehaviour>);
    /// The log of another node contradicts the one of this node.
    fn contradicted(&self, found: Contradiction);
}
