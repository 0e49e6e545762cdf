//! The ways to be ordered through this node: its slot, the members and the connections to them.

use crate::ordering::directory::Directory;
use crate::ordering::orderer_slot::OrdererSlot;
use crate::peers::connections::Peers;
use crate::storage::space::Space;
use std::sync::Arc;

/// Where ordering is and who takes part; cheap to clone.
#[derive(Clone)]
pub(crate) struct Reachability {
    /// The number of this node.
    pub me: u64,
    /// Where ordering is, when it is.
    pub slot: Arc<OrdererSlot>,
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// The ways to the other nodes.
    pub peers: Arc<Peers>,
    /// The room that the disk still has.
    pub space: Arc<Space>,
}

impl Reachability {
    /// Can nothing be ordered through this node at the moment: no leader is known or reached, it lacks too much, or its
    /// disk is full?
    pub(crate) fn is_cut_off(&self) -> bool {
        !self.reaches_leader() || self.space.is_full()
    }

    /// Does this node follow a leader that it reaches, or lead?
    pub(crate) fn reaches_leader(&self) -> bool {
        let leader = self.slot.status().and_then(|ordering| ordering.role.leader);
        self.slot.catching_up_to().is_none() && leader.is_some_and(|id| self.is_connected(id))
    }

    /// Is this node connected with that one, or is it that one?
    pub(crate) fn is_connected(&self, id: u64) -> bool {
        id == self.me || self.peers.connected(id)
    }
}
