//! An emergency stop is told before it is ordered: without a leader, without a majority, at every node.

use crate::support::network::register_robots;
use crate::support::wait::PATIENCE;
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
