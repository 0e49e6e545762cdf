//! Subscribers of one robot, while another is driven.

use crate::support::network::{message, register_robots};
use crate::support::wait::PATIENCE;
use crate::support::{Fleet, connect, wire};
use bytes::Bytes;
use ledger_abac::MessageEvent;
use ledger_api::v1::SubscribeRequest;
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::{Client, Context, Subscription};
use ledger_identity::Role;
use std::time::Instant;

const QUIET: &str = "Husky/cmd_vel";
/// Far longer than the time between two commands, in milliseconds.
const HEARTBEAT_MS: u32 = 400;

fn of_the_quiet_one() -> Subscription {
    Subscription {
        from_height: 1,
        chaincode: "abac".into(),
        subjects: vec![QUIET.into()],
        names: vec!["message".into()],
        heartbeat: HEARTBEAT_MS,
        ..Subscription::default()
    }
}

async fn acquire(client: &Client, robot: &'static str) {
    client.invoke("abac", "acquire", vec![robot.into(), "600000".into()]).await.unwrap();
}

/// Drives the busy robot without a pause, for as long as the other future takes.
async fn while_busy<T>(driver: &Client, first_seq: u64, what: impl Future<Output = T>) -> T {
    let driven = async {
        for seq in first_seq.. {
            driver.invoke("abac", "set", message(1, seq, b"busy")).await.unwrap();
        }
    };
    tokio::select! {
        () = driven => unreachable!("numbers ran out"),
        done = what => done,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_subscriber_who_wants_nothing_of_what_happens_gets_heartbeats_that_say_how_far_the_node_is() {
    let fleet = Fleet::found(1);
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let admin = fleet.owner();
    let mut node = fleet.nodes[0].start();
    let (owner, driver) = (connect(&admin).await, connect(&salma).await);
    register_robots(&owner, "exclusive").await;
    acquire(&driver, "Turtlebot4").await;

    let others = SubscribeRequest { subjects: vec![QUIET.into()], ..SubscribeRequest::default() };
    // As the bridge of whoever drives: blocks do concern the robot, but what is in them is not wanted.
    let own = SubscribeRequest {
        subjects: vec!["Turtlebot4/cmd_vel".into()],
        names: vec!["granted".into()],
        ..SubscribeRequest::default()
    };
    for (wanted, first_seq) in [(others, 0), (own, 1_000_000)] {
        let heights = while_busy(&driver, first_seq, heartbeats(&admin, wanted)).await;
        assert!(heights.is_sorted() && heights.first() < heights.last(), "{heights:?}: a robot was driven meanwhile");
    }
    node.interrupt();
}

/// Heights of the first heartbeats of a subscription, at least three, until they have grown.
async fn heartbeats(who: &Context, wanted: SubscribeRequest) -> Vec<u64> {
    // Without the client, which would come back through another connection when it hears nothing.
    let channel = wire::channel(who, true).await;
    let request = SubscribeRequest { heartbeat_ms: HEARTBEAT_MS, ..wanted };
    let mut heard = GatewayClient::new(channel).subscribe(request).await.unwrap().into_inner();
    let deadline = Instant::now() + PATIENCE;
    let mut heights = Vec::new();
    while heights.len() < 3 || heights.first() == heights.last() {
        let delivery = tokio::time::timeout_at(deadline.into(), heard.message()).await.expect("no heartbeat");
        let delivery = delivery.unwrap().expect("the stream ended");
        assert!(delivery.events.is_empty(), "nothing happened that is wanted");
        heights.push(delivery.height);
    }
    heights
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_subscriber_hears_its_robot_once_and_whole_among_others() {
    let fleet = Fleet::found(1);
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let nadia = fleet.issue("Org1", "Nadia", Role::Member, &["Husky"]);
    let owner = fleet.owner();
    let mut node = fleet.nodes[0].start();
    let (owner, busy, quiet) = (connect(&owner).await, connect(&salma).await, connect(&nadia).await);
    register_robots(&owner, "exclusive").await;
    acquire(&busy, "Turtlebot4").await;
    acquire(&quiet, "Husky").await;

    const MESSAGES: u64 = 200;
    let publish = async |seqs: std::ops::Range<u64>| {
        for seq in seqs {
            let mut args = message(1, seq, b"quiet");
            args[0] = Bytes::from_static(QUIET.as_bytes());
            quiet.invoke("abac", "set", args).await.unwrap();
        }
    };
    // A part is history when the subscriber comes.
    while_busy(&busy, 0, publish(0..MESSAGES / 2)).await;
    let mut streams = [of_the_quiet_one(), Subscription { subjects: Vec::new(), ..of_the_quiet_one() }]
        .map(|wanted| owner.subscribe(wanted));
    let deadline = Instant::now() + PATIENCE;
    let listen = async {
        let mut heard = [Vec::new(), Vec::new()];
        for (stream, heard) in streams.iter_mut().zip(&mut heard) {
            while heard.len() < MESSAGES as usize {
                let delivery = tokio::time::timeout_at(deadline.into(), stream.next()).await.expect("lost").unwrap();
                for event in delivery.events.iter().filter(|event| event.subject == QUIET) {
                    heard.push(serde_json::from_slice::<MessageEvent>(&event.payload).unwrap().first_seq);
                }
            }
        }
        heard
    };
    let both = async { tokio::join!(listen, publish(MESSAGES / 2..MESSAGES)).0 };
    for heard in while_busy(&busy, 1_000_000, both).await {
        assert_eq!(heard, (0..MESSAGES).collect::<Vec<_>>());
    }
    node.interrupt();
}
