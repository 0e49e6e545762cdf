#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::trust::tests::built as trust;
use std::path::Path;
use tempfile::TempDir;

/// The first four subsystems of the only node of a network that was founded in this directory.
pub(crate) fn built(place: &Path) -> (Config, Arc<Ordering>, Arc<Trust>, Arc<Peers>) {
    let (config, ordering, trust) = trust(place);
    let (peers, _tasks) = Peers::new(&config, &ordering, &trust, &ordering.author(&trust.identity)).unwrap();
    (config, ordering, trust, peers)
}

#[tokio::test]
async fn a_node_without_a_leader_is_cut_off_and_is_connected_with_itself_alone() {
    let place = TempDir::new().unwrap();
    let (_, _, _, peers) = built(place.path());
    assert!(!peers.reachability.reaches_leader() && peers.reachability.is_cut_off());
    assert!(peers.reachability.is_connected(1) && !peers.reachability.is_connected(2));
}

#[tokio::test]
async fn nothing_is_certified_and_nobody_differs_at_the_genesis() {
    let place = TempDir::new().unwrap();
    let (_, _, _, peers) = built(place.path());
    assert_eq!((peers.certificates.certified(), peers.monitor.describe().as_str()), (0, ""));
}
