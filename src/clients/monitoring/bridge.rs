//! A bridge that is a process of its own, as its page shows it.

mod checks;
mod metrics;

use super::Watched;
use super::check::Check;
use ledger_base::rejection::Rejection;
pub(super) use metrics::register;
use prometheus_client::registry::Registry;
use ros_bridge::BridgeMonitor;

impl Watched for BridgeMonitor {
    fn checks(&self) -> Vec<Check> {
        checks::all(&self.look())
    }

    fn register(&self, registry: &mut Registry) -> Result<(), Rejection> {
        register(registry, &self.look());
        Ok(())
    }
}
