//! Several instances in one process: each has a ledger, stores, certificate and threads of its own.

use crate::support::network::{free_address, now};
use bytes::Bytes;
use ledger_api::Client;
use ledger_identity::Role;
use ledger_identity::key::KeyKind;
use ledgerd::Node;
use ledgerd::config::Config;
use ledgerd::setup::{NetworkPlan, PlannedNode, PlannedOrganisation, found, issue};
use std::collections::BTreeMap;
use std::path::Path;

/// A network of one node in this process, and a client of its admin.
async fn network(root: &Path, label: &str) -> (Node, Client) {
    let (data, address) = (root.join(label), free_address());
    let node = PlannedNode {
        name: "node1".into(),
        organisation: "Org1".into(),
        data: data.clone(),
        address: address.clone(),
        voter: true,
    };
    let plan = NetworkPlan {
        label: label.into(),
        organisations: vec![PlannedOrganisation { name: "Org1".into(), key: KeyKind::Ed25519 }],
        nodes: vec![node],
        snapshot_every: ledger::network::SNAPSHOT_EVERY_DEFAULT,
    };
    found(&plan, now()).unwrap();
    let admin = issue(&data, "Org1", ("Admin", Role::Admin), BTreeMap::new(), &address, now()).unwrap();
    let config = Config { data, listen: address, ..Config::default() };
    let node = Node::builder().start(&config).await.unwrap();
    (node, Client::connect(&admin).await.unwrap())
}

/// A robot's description, as `setup` takes it.
fn robot(name: &str) -> Vec<Bytes> {
    let service = serde_json::json!({"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "open"});
    let robot = serde_json::json!({"name": name, "attribute_required": name, "services": [service]});
    vec![Bytes::from(robot.to_string())]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_ledgers_run_in_one_process_and_neither_notices_the_other() {
    let root = tempfile::tempdir().unwrap();
    let (first, admin) = network(root.path(), "first").await;
    let (second, other) = network(root.path(), "second").await;
    assert_ne!(first.ledger().network(), second.ledger().network());

    let here = admin.invoke("abac", "setup", robot("Husky")).await.unwrap();
    let there = other.invoke("abac", "setup", robot("Turtlebot4")).await.unwrap();
    assert!(first.ledger().transaction(&here.id).unwrap().is_some());
    assert!(first.ledger().transaction(&there.id).unwrap().is_none(), "a block of the other ledger");
    assert!(second.ledger().transaction(&there.id).unwrap().is_some());

    first.stop().await;
    let after = other.invoke("abac", "setup", robot("Leo")).await.unwrap();
    assert!(after.height > there.height, "the second goes on without the first");
    second.stop().await;
}
