//! The other users of a topic in shared memory.

use std::{collections::BTreeMap, sync::Arc};

use iceoryx2::{
    identifiers::UniqueNodeId,
    node::{NodeState, NodeView},
    prelude::{CallbackProgression, PortFactory},
    service::ipc_threadsafe::Service,
};

use super::service::DataService;
use crate::graph::endpoint::Role;

/// Between the name of a bridge's node and its origin.
const ORIGIN: char = '@';

/// Counts who uses a topic in shared memory.
#[derive(Clone)]
pub(crate) struct Peers {
    pub(super) data: Arc<DataService>,
    pub(super) role: Role,
    /// The node of this bridge.
    pub(super) own: UniqueNodeId,
}

/// A publisher of another process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Publisher {
    /// Unique in the world.
    pub(crate) id: u128,
    /// Its process; none if shared memory does not tell.
    pub(crate) process: Option<u32>,
    /// The origin of the bridge that it belongs to, if it says so.
    pub(crate) bridge: Option<[u8; 16]>,
}

/// A node that uses the topic.
struct PeerNode {
    is_dead: bool,
    bridge: Option<[u8; 16]>,
}

impl Peers {
    /// The endpoints that it counts.
    pub(crate) fn role(&self) -> Role {
        self.role
    }

    /// How many there are now. Those of a process that was killed count until another one cleans up.
    pub(crate) fn count(&self) -> usize {
        match self.role {
            Role::Publisher => self.data.dynamic_config().number_of_publishers(),
            Role::Subscriber => self.data.dynamic_config().number_of_subscribers(),
        }
    }

    /// The publishers of other processes that are alive.
    pub(crate) fn publishers(&self) -> Vec<Publisher> {
        let mut others = Vec::new();
        self.data.dynamic_config().list_publishers(|details| {
            if details.node_id != self.own {
                others.push((details.publisher_id.value(), details.node_id));
            }
            CallbackProgression::Continue
        });
        // A look at the nodes opens files: only where somebody is there.
        let nodes = if others.is_empty() { BTreeMap::new() } else { self.nodes() };
        let alive = others.into_iter().filter(|(_, node)| !nodes.get(node).is_some_and(|known| known.is_dead));
        alive.map(|(id, node)| publisher(id, node, nodes.get(&node))).collect()
    }

    /// The nodes that use the topic. Empty if they cannot be listed: whoever is not known counts as alive.
    fn nodes(&self) -> BTreeMap<UniqueNodeId, PeerNode> {
        let mut nodes = BTreeMap::new();
        let listed = self.data.nodes(|state| {
            let bridge = match &state {
                NodeState::Alive(node) => node.details().as_ref().and_then(|details| origin(details.name().as_str())),
                NodeState::Dead(_) | NodeState::Inaccessible(_) | NodeState::Undefined(_) => None,
            };
            let is_dead = matches!(state, NodeState::Dead(_));
            nodes.insert(*state.node_id(), PeerNode { is_dead, bridge });
            CallbackProgression::Continue
        });
        if listed.is_err() {
            tracing::debug!("the nodes in shared memory cannot be listed");
        }
        nodes
    }
}

fn publisher(id: u128, node: UniqueNodeId, known: Option<&PeerNode>) -> Publisher {
    let process = node.pid::<Service>().ok().and_then(|pid| u32::try_from(pid.value()).ok());
    Publisher { id, process, bridge: known.and_then(|known| known.bridge) }
}

/// The name of a bridge's node: others know by it to which participant of DDS it belongs.
pub(crate) fn bridge_name(name: &str, of: [u8; 16]) -> String {
    format!("{name}{ORIGIN}{}", hex::encode(of))
}

/// The origin in the name of a node.
fn origin(name: &str) -> Option<[u8; 16]> {
    let (_, digits) = name.rsplit_once(ORIGIN)?;
    hex::decode(digits).ok()?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_origin_of_a_bridge_stands_in_the_name_of_its_node() {
        assert_eq!(origin(&bridge_name("ledgerd_bridge", [7; 16])), Some([7; 16]));
        for none in ["", "teleop", "a@b", "@", &format!("x@{}", "0".repeat(30)), &format!("x@{}", "g".repeat(32))] {
            assert_eq!(origin(none), None, "{none}");
        }
    }
}
