//! Nodes that come back to another network than they left: a voter whose disk was set back, and a node that was removed.

use crate::support::directory::copy;
use crate::support::network::{NodeWish, free_address, message, now, register_robots};
use crate::support::process::Process;
use crate::support::{Fleet, connect, eventually, until};
use ledger_api::{Client, Context};
use ledger_identity::Role;
use serde_json::json;
use std::ops::Range;
use std::path::PathBuf;

/// Three voters, the second of another organisation; and a learner.
struct Network {
    fleet: Fleet,
    nodes: Vec<Option<Process>>,
    owner: Context,
    salma: Context,
}

impl Network {
    async fn start(learner: bool) -> Self {
        let wish = |name: &str, organisation: &str, voter| NodeWish {
            name: name.into(),
            organisation: organisation.into(),
            voter,
            address: free_address(),
        };
        let mut wishes = vec![wish("node1", "Org1", true), wish("node2", "Org2", true), wish("node3", "Org1", true)];
        wishes.extend(learner.then(|| wish("node4", "Org2", false)));
        let fleet = Fleet::found_with(&wishes, now());
        // No attestation tells what a voter had.
        fleet.nodes.iter().for_each(|place| place.configure("[order]\nattest_ms = 3600000"));
        let owner = fleet.owner();
        let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
        let nodes = fleet.nodes.iter().map(|place| Some(place.start())).collect();
        let network = Self { fleet, nodes, owner, salma };
        register_robots(&network.at(0, &network.owner).await, "open").await;
        network
    }

    async fn at(&self, node: usize, person: &Context) -> Client {
        connect(&Context { nodes: vec![self.fleet.nodes[node].address.clone()], ..person.clone() }).await
    }

    fn stop(&mut self, node: usize) {
        self.nodes[node].take().unwrap().interrupt();
    }

    fn start_again(&mut self, node: usize) {
        self.nodes[node] = Some(self.fleet.nodes[node].start());
    }

    /// Publishes through a node; answers with the last height.
    async fn publish(&self, node: usize, sequence: Range<u64>) -> u64 {
        let client = self.at(node, &self.salma).await;
        let mut height = 0;
        for seq in sequence {
            height = client.invoke("abac", "set", message(0, seq, &seq.to_be_bytes())).await.unwrap().height;
        }
        height
    }

    async fn reaches(&self, node: usize, height: u64) {
        let client = self.at(node, &self.owner).await;
        until("the node has the block", || async { (client.status().await.ok()?.height >= height).then_some(()) })
            .await;
    }

    /// Copies the first node's disk, and goes on without the third one; answers with the height of the copy.
    async fn go_on_after_a_copy(&mut self) -> u64 {
        let height = self.publish(0, 1..10).await;
        for node in 0..self.nodes.len() {
            self.reaches(node, height).await;
        }
        // The third one goes before the first one has more than the copy.
        self.stop(0);
        self.keep(0);
        self.stop(2);
        self.start_again(0);
        height
    }

    fn kept(&self, node: usize) -> PathBuf {
        self.fleet.path().join(format!("kept{node}"))
    }

    /// Copies the disk of a stopped node.
    fn keep(&self, node: usize) {
        copy(&self.fleet.nodes[node].data, &self.kept(node));
    }

    /// Sets the disk of a stopped node back to the copy.
    fn set_back(&self, node: usize) {
        std::fs::remove_dir_all(&self.fleet.nodes[node].data).unwrap();
        copy(&self.kept(node), &self.fleet.nodes[node].data);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn after_a_voter_was_set_back_the_node_with_the_other_history_stops_and_all_others_show_it() {
    let mut network = Network::start(false).await;
    network.go_on_after_a_copy().await;
    let acknowledged = network.publish(1, 10..30).await;
    network.reaches(0, acknowledged).await;
    network.stop(0);
    network.stop(1);
    network.set_back(0);
    network.start_again(0);
    network.start_again(2);
    // Two of three order, and know nothing of what the first one had acknowledged.
    network.publish(0, 100..110).await;

    network.start_again(1);
    let mut second = network.nodes[1].take().unwrap();
    let ended = second.wait();
    let log = second.stderr();
    assert_eq!(ended.code(), Some(7), "{ended}\n{log}");
    assert!(log.contains("LGR-5008") && log.contains("the history of most voters differs"), "{log}");
    for node in [0, 2] {
        let observer = network.at(node, &network.owner).await;
        until("the others show it", || async {
            observer.status().await.ok()?.divergence.contains("Org2/node2 has another block at height").then_some(())
        })
        .await;
        network.nodes[node].as_mut().unwrap().check();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_voter_that_was_set_back_does_not_start_where_a_peer_remembers_what_it_had_confirmed() {
    let mut network = Network::start(true).await;
    let copied = network.go_on_after_a_copy().await;
    let acknowledged = network.publish(1, 10..30).await;
    // A learner has asked the voters, and keeps what they said on its disk.
    let kept = network.fleet.nodes[3].data.join("confirmed.json");
    until("the learner keeps it", || async {
        let kept: serde_json::Value = serde_json::from_slice(&std::fs::read(&kept).ok()?).ok()?;
        (kept["1"]["height"].as_u64()? >= acknowledged).then_some(())
    })
    .await;
    for node in [0, 1, 3] {
        network.stop(node);
    }
    [2, 3].into_iter().for_each(|node| network.keep(node));
    let mut tries = 0;
    let (ended, log) = loop {
        network.set_back(0);
        network.start_again(3);
        network.start_again(2);
        network.reaches(3, copied).await;
        let before = network.fleet.nodes[0].logged().len();
        network.start_again(0);
        let mut first = network.nodes[0].take().unwrap();
        let ends = eventually("the first node ends, or begins", || {
            let begins = first.stderr().split_off(before).contains("starting without the answer of unreachable nodes");
            if first.is_running() { begins.then_some(false) } else { Some(true) }
        });
        if ends {
            break (first.wait(), first.stderr().split_off(before));
        }
        // On a busy machine the learner's answer came too late. Nobody keeps what followed.
        tries += 1;
        assert!(tries < 20, "the learner is never heard in time: {}", first.stderr());
        first.kill();
        for node in [2, 3] {
            network.nodes[node].take().unwrap().kill();
            network.set_back(node);
        }
    };
    assert!(!ended.success() && log.contains("this voter has lost blocks that it had before"), "{ended}\n{log}");
    assert!(log.contains("according to Org2/node4, which shows this node's own receipt"), "{log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_learner_that_makes_up_what_a_voter_had_confirmed_keeps_it_from_nothing() {
    let mut network = Network::start(true).await;
    let acknowledged = network.publish(1, 1..10).await;
    let lie = json!({"1": {"height": 1_000_000_000_000_u64, "receipt": "00".repeat(32)}}).to_string();
    let mut next = 10;
    loop {
        network.stop(3);
        std::fs::write(network.fleet.nodes[3].data.join("confirmed.json"), &lie).unwrap();
        network.start_again(3);
        network.reaches(3, acknowledged).await;
        let before = network.fleet.nodes[0].logged().len();
        network.stop(0);
        network.start_again(0);
        let after = network.publish(1, next..next + 10).await;
        network.reaches(0, after).await;
        let log = network.fleet.nodes[0].logged().split_off(before);
        if log.contains("without showing a receipt") && log.contains("Org2/node4") {
            break;
        }
        // On a busy machine the learner's answer came too late.
        next += 10;
        assert!(next < 210, "the learner is never heard in time: {log}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_was_removed_while_it_was_down_learns_so_and_ends_with_a_code_of_its_own() {
    let mut network = Network::start(false).await;
    let boss = network.fleet.issue("Org1", "Boss", Role::Admin, &[]);
    let boss = network.at(0, &boss).await;
    network.stop(2);
    let leave = json!({"organisation": "Org1", "name": "node3", "role": "removed"}).to_string();
    boss.invoke("msp", "set_node_role", vec![leave.into()]).await.unwrap();
    until("the others have let it go", || async {
        boss.status().await.ok()?.peers.iter().all(|peer| peer.name != "node3").then_some(())
    })
    .await;
    for _ in 0..2 {
        network.start_again(2);
        let mut third = network.nodes[2].take().unwrap();
        let ended = third.wait();
        let log = third.stderr();
        assert_eq!(ended.code(), Some(6), "{ended}\n{log}");
        assert!(log.contains("LGR-2011") && log.contains("was removed from the network"), "{log}");
    }
    for node in [0, 1] {
        network.nodes[node].as_mut().unwrap().check();
    }
}
