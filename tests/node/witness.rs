//! Attestations, and a node whose world state is not that of the others.

use crate::support::ctl::verify;
use crate::support::network::{NodePlace, NodeWish, free_address, message, now, register_robots};
use crate::support::{Fleet, connect, until};
use bytes::Bytes;
use ledger_api::{Client, Context};
use ledger_identity::Role;
use ledger_storage::layout::STATE_DIRECTORY;
use ledger_storage::state::{SledStore, Store, WriteSet};

fn wish(name: &str, organisation: &str) -> NodeWish {
    NodeWish { name: name.into(), organisation: organisation.into(), voter: true, address: free_address() }
}

async fn publish(client: &Client, sequence: std::ops::Range<u64>) -> u64 {
    let mut height = 0;
    for seq in sequence {
        height = client.invoke("abac", "set", message(0, seq, b"forwards")).await.unwrap().height;
    }
    height
}

/// Lets a stopped node remember that messages were published which were not.
fn spoil(place: &NodePlace) {
    let store = SledStore::open(&place.data.join(STATE_DIRECTORY)).unwrap();
    let tip = store.get(b"\0tip").unwrap().unwrap();
    let spoilt: WriteSet = store
        .range(b"abac\0last/", None, 10)
        .unwrap()
        .into_iter()
        .map(|(key, value)| {
            let mut last: serde_json::Value = serde_json::from_slice(&value).unwrap();
            last["seq"] = 1_000_000_000_u64.into();
            (key, Some(Bytes::from(last.to_string())))
        })
        .collect();
    assert_eq!(spoilt.len(), 1, "Salma has published");
    store.write(&spoilt, (b"\0tip", &tip)).unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_most_others_contradict_stops_names_the_key_and_comes_back_right() {
    let fleet = Fleet::found_with(&[wish("node1", "Org1"), wish("node2", "Org2"), wish("node3", "Org1")], now());
    for place in &fleet.nodes {
        place.configure("[order]\nattest_ms = 100");
    }
    let owner = fleet.owner();
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let at = async |node: usize, person: &Context| {
        connect(&Context { nodes: vec![fleet.nodes[node].address.clone()], ..person.clone() }).await
    };
    let mut nodes: Vec<_> = fleet.nodes.iter().map(NodePlace::start).collect();
    register_robots(&at(0, &owner).await, "open").await;
    let client = at(0, &salma).await;
    let height = publish(&client, 1..10).await;
    until("node3 has it too", async || (at(2, &salma).await.status().await.ok()?.height >= height).then_some(())).await;
    nodes[2].interrupt();
    spoil(&fleet.nodes[2]);
    nodes[2] = fleet.nodes[2].start();
    publish(&client, 10..20).await;
    let ended = nodes[2].wait();
    let log = nodes[2].stderr();
    assert!(!ended.success() && log.contains("LGR-5006"), "{ended}\n{log}");
    assert!(log.contains("is the first that differs, in key abac\\x00last/"), "{log}");

    // Its next start makes the world state anew.
    nodes[2] = fleet.nodes[2].start();
    let height = publish(&client, 20..30).await;
    until("node3 agrees", async || {
        let (one, three) = (client.status().await.ok()?, at(2, &salma).await.status().await.ok()?);
        (three.height >= height && three.height == one.height && three.state_digest == one.state_digest).then_some(())
    })
    .await;
    assert_eq!(at(2, &salma).await.status().await.unwrap().divergence, "");
    nodes.iter_mut().for_each(|node| node.interrupt());
    for place in &fleet.nodes {
        let report = verify(&place.data).ok().json();
        assert!(report["attestations_agreeing"].as_u64().unwrap() > 0, "{report}");
        assert_eq!(report["state_compared"], true, "{report}");
    }
}
