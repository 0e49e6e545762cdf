//! Two networks of one node each behind one listener, in the process of the test.

use crate::network::now;
use ledger_api::Context;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledgerd::config::Config;
use ledgerd::setup::{NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use ledgerd::{Host, Node};
use std::collections::BTreeMap;
use std::path::Path;

/// Founds a network of one node that is reached at this address: the node's settings, and its admin.
pub fn founded(root: &Path, label: &str, address: &str) -> (Config, Context) {
    let data = root.join(label);
    let node = PlannedNode {
        name: "node1".into(),
        organisation: "Org1".into(),
        data: data.clone(),
        address: address.into(),
        voter: true,
    };
    let plan = NetworkPlan {
        label: label.into(),
        organisations: vec![PlannedOrganisation { name: "Org1".into(), key: KeyKind::Ed25519 }],
        nodes: vec![node],
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
    };
    found(&plan, now()).unwrap();
    let admin = issue(&data, "Org1", ("Admin", Role::Admin), BTreeMap::new(), address, now()).unwrap();
    (Config { data, listen: address.into(), ..Config::default() }, admin)
}

/// The process, and each node with the admin of its network.
pub async fn two_networks(root: &Path) -> (Host, [(Node, Context); 2]) {
    let host = Host::listen("127.0.0.1:0").await.unwrap();
    let address = host.address().to_string();
    let [(here, admin), (there, other)] = ["first", "second"].map(|label| founded(root, label, &address));
    let first = Node::builder().start_on(&host, &here).await.unwrap();
    let second = Node::builder().start_on(&host, &there).await.unwrap();
    (host, [(first, admin), (second, other)])
}
