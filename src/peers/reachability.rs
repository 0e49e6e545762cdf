//! Whether calls can be ordered through this node now.

use crate::ordering::Ordering;
use crate::peers::connections::Connections;
use std::sync::Arc;

/// Whether this node reaches the leader.
pub(crate) struct Reachability {
    me: u64,
    ordering: Arc<Ordering>,
    connections: Arc<Connections>,
}

impl Reachability {
    /// Of the node with this number.
    pub(crate) fn new(me: u64, ordering: &Arc<Ordering>, connections: &Arc<Connections>) -> Arc<Self> {
        Arc::new(Self { me, ordering: Arc::clone(ordering), connections: Arc::clone(connections) })
    }

    /// Can nothing be ordered through this node at the moment: no leader is known or reached, it lacks too much, or its
    /// disk is full?
    pub(crate) fn is_cut_off(&self) -> bool {
        !self.reaches_leader() || self.ordering.storage.space.is_full()
    }

    /// Does this node follow a leader that it reaches, or lead?
    pub(crate) fn reaches_leader(&self) -> bool {
        let slot = &self.ordering.slot;
        let leader = slot.status().and_then(|ordering| ordering.role.leader);
        slot.catching_up_to().is_none() && leader.is_some_and(|id| self.is_connected(id))
    }

    /// Is this node connected with that one, or is it that one?
    pub(crate) fn is_connected(&self, id: u64) -> bool {
        id == self.me || self.connections.connected(id)
    }
}
