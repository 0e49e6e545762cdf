//! Several ledgers in one process: each has stores, certificate and threads of its own. They have a listener each, or
//! share one.

use crate::support::network::free_address;
use crate::two_networks::{founded, two_networks};
use bytes::Bytes;
use ledger_api::{Client, Context, Enrolment};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledgerd::config::Config;
use ledgerd::{Host, Node};
use std::path::Path;

/// A network of one node in this process, and a client of its admin.
async fn network(root: &Path, label: &str) -> (Node, Client) {
    let (config, admin) = founded(root, label, &free_address());
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

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_ledgers_behind_one_listener_each_serve_their_own_clients() {
    let root = tempfile::tempdir().unwrap();
    let (_host, [(first, admin), (second, other)]) = two_networks(root.path()).await;

    let (of_first, of_second) = (Client::connect(&admin).await.unwrap(), Client::connect(&other).await.unwrap());
    let husky = of_first.invoke("abac", "setup", robot("Husky")).await.unwrap();
    let leo = of_second.invoke("abac", "setup", robot("Leo")).await.unwrap();
    assert!(first.ledger().transaction(&husky.id).unwrap().is_some());
    assert!(second.ledger().transaction(&leo.id).unwrap().is_some());
    assert!(first.ledger().transaction(&leo.id).unwrap().is_none(), "a block of the other ledger");

    first.stop().await;
    let after = of_second.invoke("abac", "setup", robot("Turtlebot4")).await.unwrap();
    assert!(after.height > leo.height, "the second goes on without the first");
    second.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_listener_of_two_ledgers_refuses_a_client_that_names_neither() {
    let root = tempfile::tempdir().unwrap();
    let (host, [(first, admin), (second, _)]) = two_networks(root.path()).await;
    let address = host.address();

    let stranger = Context { network: Hash::of(&[b"third"]), ..admin.clone() };
    let refused = Client::connect(&stranger).await.err().unwrap();
    assert_eq!(refused.code, Code::WrongNetwork, "{refused}");
    assert_eq!(refused.message, format!("the process at {address} does not serve this network"));
    assert_eq!(refused.wanted, format!("network {}", stranger.network));

    let authority = Hash::of(&[admin.msps.get("Org1").unwrap().roots().next().unwrap()]);
    let unnamed = Enrolment::new(address.to_string(), authority);
    let refused = unnamed.network().await.unwrap_err();
    assert_eq!(refused.message, format!("the process at {address} serves several networks, and the call names none"));
    let told = unnamed.into_network(admin.network).network().await.unwrap();
    assert_eq!(told.label, "first");

    first.stop().await;
    second.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_listener_serves_one_node_of_a_network_and_is_closed_with_the_last() {
    let root = tempfile::tempdir().unwrap();
    let host = Host::listen("127.0.0.1:0").await.unwrap();
    let address = host.address().to_string();
    let (config, _) = founded(root.path(), "first", &address);
    let node = Node::builder().start_on(&host, &config).await.unwrap();
    let copy = root.path().join("copy");
    let copied = std::process::Command::new("cp").arg("-r").args([&config.data, &copy]).status().unwrap();
    assert!(copied.success());

    let twin = Config { data: copy, ..config.clone() };
    let refused = Node::builder().start_on(&host, &twin).await.err().unwrap();
    assert_eq!(refused.message, "one address cannot serve two nodes of a network");

    drop(host);
    node.stop().await;
    tokio::net::TcpListener::bind(&address).await.unwrap();
}
