//! An emergency stop is told before it is ordered: without a leader, without a majority, at every node.

use crate::support::network::register_robots;
use crate::support::wait::{PATIENCE, until};
use crate::support::{Fleet, connect};
use ledger_api::{Client, Context, EventStream, Subscription, v1::Delivery};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use std::time::Instant;

const ROBOT: &str = "Turtlebot4";

/// The same person, at another node.
fn at(context: &Context, fleet: &Fleet, node: usize) -> Context {
    Context { nodes: vec![fleet.nodes[node].address.clone()], ..context.clone() }
}

/// The stops of the robot as a client hears them; early ones, too, if it asks for them.
async fn stops(client: &Client, early: bool) -> EventStream {
    let (chaincode, names) = ("abac".to_owned(), vec!["stopped".to_owned()]);
    let wanted = Subscription { chaincode, subjects: vec![ROBOT.into()], names, early, ..Subscription::default() };
    let mut stream = client.subscribe(wanted);
    stream.open().await.unwrap();
    stream
}

/// The next delivery with an event.
async fn heard(stream: &mut EventStream) -> Delivery {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let delivery = tokio::time::timeout_at(deadline.into(), stream.next()).await.expect("nothing is told").unwrap();
        if !delivery.events.is_empty() {
            return delivery;
        }
    }
}

fn stop(client: &Client) -> impl Future<Output = Result<u64, Code>> + use<> {
    let client = client.clone();
    async move {
        let stopped = client.invoke("abac", "stop", vec![ROBOT.into(), "person in the cell".into()]).await;
        stopped.map(|done| done.height).map_err(|refused| refused.code)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_node_tells_of_a_stop_once_without_waiting_for_its_block_and_again_in_that() {
    let fleet = Fleet::found(2);
    let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &[ROBOT]));
    let _nodes = (fleet.nodes[0].start(), fleet.nodes[1].start());
    let (leader, follower) = (connect(&at(&owner, &fleet, 0)).await, connect(&at(&owner, &fleet, 1)).await);
    register_robots(&leader, "exclusive").await;
    let registered = leader.height_seen();
    let member = connect(&at(&salma, &fleet, 0)).await;
    follower.query_at(registered, "abac", "robots", Vec::new()).await.unwrap();
    let mut streams = Vec::new();
    for client in [&leader, &follower] {
        streams.push((stops(client, true).await, stops(client, false).await));
    }
    // Nobody hears of what policies do not permit.
    assert_eq!(stop(&member).await, Err(Code::DeniedByPolicy));
    let height = stop(&leader).await.unwrap();
    for (asked, others) in &mut streams {
        // A small network orders so quickly that the block may be told first.
        let mut both = [heard(asked).await, heard(asked).await];
        both.sort_by_key(|delivery| !delivery.early);
        let [early, ordered] = both;
        assert!(early.early && early.height <= height, "{early:?}");
        assert_eq!((early.events.len(), early.events[0].name.as_str()), (1, "stopped"));
        assert!(!early.events[0].transaction.is_empty(), "with the signed call");
        assert_eq!((ordered.early, ordered.height), (false, height));
        assert_eq!(ordered.events[0].payload, early.events[0].payload, "it was told as it came");
        let only = heard(others).await;
        assert_eq!((only.early, only.height), (false, height), "who did not ask hears of what has happened");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_is_told_where_nothing_can_be_ordered() {
    let fleet = Fleet::found(2);
    let owner = fleet.owner();
    let (voter, _follower) = (fleet.nodes[0].start(), fleet.nodes[1].start());
    let leader = connect(&at(&owner, &fleet, 0)).await;
    register_robots(&leader, "exclusive").await;
    let registered = leader.height_seen();
    let follower = connect(&at(&owner, &fleet, 1)).await;
    follower.query_at(registered, "abac", "robots", Vec::new()).await.unwrap();
    let mut told = stops(&follower, true).await;
    drop(voter);
    let ordered = tokio::spawn(stop(&follower));
    let delivery = heard(&mut told).await;
    assert!(delivery.early && delivery.events[0].subject == ROBOT, "{delivery:?}");
    assert!(!ordered.is_finished(), "nobody orders it");
    // It was not lost: it is ordered when somebody leads again.
    let _voter = fleet.nodes[0].start();
    let height = ordered.await.unwrap().unwrap();
    let delivery = heard(&mut told).await;
    assert_eq!((delivery.early, delivery.height), (false, height));
}

/// Is the robot stopped, as the ledger has it?
async fn is_stopped(owner: &Client) -> Option<()> {
    let robot = owner.query("abac", "robot", vec![ROBOT.into()]).await.ok()?;
    let robot: serde_json::Value = serde_json::from_slice(&robot.response).unwrap();
    (!robot["stopped"].is_null()).then_some(())
}

/// The stops without a verdict at the node of the client.
async fn open_stops(client: &Client) -> usize {
    client.status().await.unwrap().open_stops.len()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_that_nobody_waits_for_is_kept_over_a_restart_told_again_and_ordered_once_somebody_leads() {
    let fleet = Fleet::found(2);
    let owner = fleet.owner();
    let (voter, follower) = (fleet.nodes[0].start(), fleet.nodes[1].start());
    let leader = connect(&at(&owner, &fleet, 0)).await;
    register_robots(&leader, "exclusive").await;
    let registered = leader.height_seen();
    let client = connect(&at(&owner, &fleet, 1)).await;
    client.query_at(registered, "abac", "robots", Vec::new()).await.unwrap();
    let mut told = stops(&client, true).await;
    drop((voter, leader));

    let ctl = fleet.ctl().as_("Admin");
    let refused = ctl.run(&["stop", ROBOT, "--timeout", "5s"]);
    refused.refused(4, &["the stop of Turtlebot4 is not in force: repeat it", "sent to the robots", "ledgerctl stop"]);
    assert!(heard(&mut told).await.early);
    // It fails, as nobody leads.
    let status: serde_json::Value = serde_json::from_str(&ctl.run(&["status", "-o", "json"]).stdout).unwrap();
    assert_eq!(status["open_stops"][0]["robot"], ROBOT, "{status}");
    drop((client, told, follower));

    let _follower = fleet.nodes[1].start();
    let client = connect(&at(&owner, &fleet, 1)).await;
    assert!(open_stops(&client).await > 0, "it is on the disk");
    let mut told = stops(&client, true).await;
    let delivery = heard(&mut told).await;
    assert!(delivery.early && delivery.events[0].subject == ROBOT, "a robot hears of it again: {delivery:?}");
    let _voter = fleet.nodes[0].start();
    until("the stop is ordered", || is_stopped(&client)).await;
    until("no stop is open", || async { (open_stops(&client).await == 0).then_some(()) }).await;
    ctl.run(&["stop", ROBOT]).ok();
    ctl.run(&["resume", ROBOT]).ok();
    assert!(is_stopped(&client).await.is_none());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ledgerctl_signs_and_sends_a_stop_again_until_it_is_in_force() {
    let fleet = Fleet::found(2);
    let owner = fleet.owner();
    let (voter, _follower) = (fleet.nodes[0].start(), fleet.nodes[1].start());
    let leader = connect(&at(&owner, &fleet, 0)).await;
    register_robots(&leader, "exclusive").await;
    let client = connect(&at(&owner, &fleet, 1)).await;
    client.query_at(leader.height_seen(), "abac", "robots", Vec::new()).await.unwrap();
    drop((voter, leader));
    let ctl = fleet.ctl().as_("Admin");
    let stopping = tokio::task::spawn_blocking(move || ctl.run(&["stop", ROBOT, "--reason", "person in the cell"]));
    until("it was signed again", || async { (open_stops(&client).await > 1).then_some(()) }).await;
    assert!(!stopping.is_finished(), "it is not in force");
    let _voter = fleet.nodes[0].start();
    let ran = stopping.await.unwrap().ok();
    assert!(ran.stdout.contains("in force"), "{}", ran.stdout);
    assert!(ran.stderr.contains("sent to the robots, not in force yet"), "{}", ran.stderr);
    assert!(is_stopped(&client).await.is_some());
}
