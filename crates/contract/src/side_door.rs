//! Side doors: somebody publishes on a robot's own topic beside the bridge, around the ledger.

use serde::{Deserialize, Serialize};

/// A side door as the robot's bridge has reported it: payload of the event `side_door`, whose subject is the service, and
/// part of [`crate::ServiceState`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SideDoor {
    /// The command service whose topic is not the bridge's alone.
    pub service: String,
    /// The local topic.
    pub topic: String,
    /// How many publish there beside the bridge; 0 once they have left.
    pub publishers: u64,
    /// The one who has reported it: the robot, or a node of its owner.
    pub by: String,
    /// When it was first reported (block time, microseconds).
    pub since: u64,
    /// When it was last reported (block time, microseconds).
    pub at: u64,
}
