//! A node as its page shows it, with the bridge that may run inside.

mod checks;
mod metrics;

use super::bridge;
use super::check::Check;
use super::{Watched, is_well};
use crate::clients::gateway::Description;
use ledger_base::rejection::Rejection;
use prometheus_client::registry::Registry;
use ros_bridge::BridgeMonitor;
use std::sync::Arc;

/// A node, for its page.
pub(crate) struct WatchedNode {
    /// The node.
    pub(crate) node: Arc<Description>,
    /// The bridge inside, if it has one: its figures are there, too. Whether the node is ready does not depend on it.
    pub(crate) bridge: Option<BridgeMonitor>,
}

impl Watched for WatchedNode {
    fn checks(&self) -> Vec<Check> {
        checks(&self.node)
    }

    fn register(&self, registry: &mut Registry) -> Result<(), Rejection> {
        metrics::register(
            registry,
            &self.node.status()?,
            &self.node.ordering.meters,
            self.node.ordering.idle_control.held(),
        );
        if let Some(bridge) = &self.bridge {
            bridge::register(registry, &bridge.look());
        }
        Ok(())
    }
}

fn checks(node: &Description) -> Vec<Check> {
    match node.status() {
        Ok(status) => checks::all(&status),
        Err(fault) => vec![Check::failed("state", fault.to_string())],
    }
}

/// Can the node do its work?
pub(crate) fn is_ready(node: &Description) -> bool {
    is_well(&checks(node))
}
