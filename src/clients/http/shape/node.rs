//! The nodes of the network.

use ledger_api::facts::StatusFacts;
use ledger_api::v1;
use serde::Serialize;

/// A node of the network by its own report, which this node has not checked.
#[derive(Serialize)]
pub(in crate::clients::http) struct NodeFacts {
    id: u64,
    name: String,
    organisation: String,
    reachable: bool,
    #[serde(skip_serializing_if = "String::is_empty")]
    reason: String,
    status: Option<StatusFacts>,
}

impl From<v1::NodeStatus> for NodeFacts {
    fn from(node: v1::NodeStatus) -> Self {
        Self {
            id: node.node_id,
            name: node.name,
            organisation: node.organisation,
            reachable: node.status.is_some(),
            reason: node.unreachable,
            status: node.status.map(StatusFacts::from),
        }
    }
}
