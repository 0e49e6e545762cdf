#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::node::NodeBuilder;
use crate::process::clock::wall;
use crate::tools::setup::{NetworkPlan, PlannedNode, PlannedOrganisation, found};
use ledger::network::SNAPSHOT_EVERY_DEFAULT;
use ledger_identity::key::KeyKind;
use ledger_storage::layout::GENESIS_FILE;
use std::path::Path;
use tempfile::TempDir;

/// The configuration of the only node of a network that was founded in this directory.
pub(crate) fn founded(place: &Path) -> Config {
    let config = Config { data: place.join("node1"), listen: "127.0.0.1:0".into(), ..Config::default() };
    let plan = NetworkPlan {
        label: "fleet".into(),
        organisations: vec![PlannedOrganisation { name: "Org1".into(), key: KeyKind::Ed25519 }],
        nodes: vec![PlannedNode {
            name: "node1".into(),
            organisation: "Org1".into(),
            data: config.data.clone(),
            address: "127.0.0.1:7450".into(),
            voter: true,
        }],
        snapshot_every: SNAPSHOT_EVERY_DEFAULT,
    };
    found(&plan, wall()).unwrap();
    config
}

/// The storage of that node.
pub(crate) fn opened(config: &Config) -> Result<Arc<Storage>, Rejection> {
    let document = std::fs::read(config.data.join(GENESIS_FILE)).unwrap();
    Storage::open(config, document, NodeBuilder::default().registry().unwrap(), &Meters::default())
}

#[test]
fn a_founded_directory_opens_at_the_genesis_and_once_at_a_time() {
    let place = TempDir::new().unwrap();
    let config = founded(place.path());
    let storage = opened(&config).unwrap();
    assert_eq!((storage.ledger.tip().height, storage.blocks.height()), (0, 0));
    assert_eq!(storage.genesis.label, "fleet");
    assert!(opened(&config).is_err(), "another process would write into the same files");
    drop(storage);
    assert!(opened(&config).is_ok());
}

#[test]
fn housekeeping_sweeps_and_ends() {
    let place = TempDir::new().unwrap();
    let storage = opened(&founded(place.path())).unwrap();
    let (swept, sweeps) = std::sync::mpsc::channel();
    let housekeeping = storage
        .housekeeping(move || {
            let _ended = swept.send(());
        })
        .unwrap();
    sweeps.recv_timeout(std::time::Duration::from_secs(60)).unwrap();
    housekeeping.stop();
    // Ends once the thread has dropped its side.
    sweeps.iter().for_each(|()| {});
}
