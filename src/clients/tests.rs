#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::clients::monitoring::is_ready;
use crate::peers::tests::built as peers;
use tempfile::TempDir;

#[tokio::test]
async fn a_node_without_an_engine_describes_itself_and_is_not_ready() {
    let place = TempDir::new().unwrap();
    let (config, ordering, trust, peers) = peers(place.path());
    let tracer = Tracer::start(&config.traces, "ledgerd", "Org1/node1");
    let clients = Clients::new(&config, &ordering, &trust, &peers, (tracer, Instant::now())).unwrap();
    let description = &clients.gateway.description;
    let status = description.status().unwrap();
    assert_eq!((status.organisation.as_str(), status.node_name.as_str(), status.node_id), ("Org1", "node1", 1));
    assert_eq!((status.height, status.leader_id), (0, 0));
    assert!(!is_ready(description), "nothing can be ordered");
}
