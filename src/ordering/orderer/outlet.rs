//! Interface from ordering to the later subsystems.

use ledger::Refusal;
use ledger_light::{DoubleHead, DoubleVote};
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
    /// A voter has voted for two nodes in one term.
    fn voted_twice(&self, proof: Box<DoubleVote>);
    /// A leader has signed two logs in one term.
    fn two_heads(&self, proof: Box<DoubleHead>);
    /// The log of another node contradicts the one of this node.
    fn contradicted(&self, found: Contradiction);
}
