//! Readers: told at once, told when the right ends, and never kept out by somebody who takes every place.

use crate::support::network::register_robots;
use crate::support::wait::{PATIENCE, until};
use crate::support::{Dev, Fleet, connect, eventually, wire};
use bytes::Bytes;
use ledger_api::v1::SubscribeRequest;
use ledger_api::v1::gateway_client::GatewayClient;
use ledger_api::{Client, Context, Options, Subscription, from_status};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use serde_json::{Value, json};
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

const TWIST: &str = "{linear: {x: 0.5}}";

/// The row of `denials` about a subscription of this person.
fn denied(dev: &Dev, who: &str) -> Value {
    let denials = dev.admin().json(&["denials"]);
    let rows = denials.as_array().unwrap().iter();
    rows.clone()
        .find(|row| row["who"] == who && row["function"] == "subscribe")
        .unwrap_or_else(|| panic!("{who} is not in {denials}"))
        .clone()
}

#[test]
fn echo_without_the_right_to_read_is_refused_at_once_and_recorded() {
    let dev = Dev::start();
    let mallory = dev.user("Mallory", &[], "ed25519");
    for from in [&[][..], &["--from", "0"], &["--from", "1"], &["--from", "999999"]] {
        let line = [&["echo", "Turtlebot4/cmd_vel"], from].concat();
        let said = mallory.run(&line).refused(2, &["LGR-3001", "may not subscribe", "found", "wanted", "try"]);
        assert_eq!(said.stdout, "");
    }
    let row = denied(&dev, "Org1/Mallory");
    assert_eq!(
        (&row["code"], &row["subject"], &row["count"]),
        (&"LGR-3001".into(), &"Turtlebot4/cmd_vel".into(), &4.into())
    );
    mallory.run(&["echo", "Nope/cmd_vel"]).refused(3, &["LGR-3003"]);
    mallory.run(&["echo", "Turtlebot4/nope"]).refused(3, &["LGR-3004"]);
}

#[test]
fn echo_from_0_begins_with_the_first_block() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    salma.json(&["acquire", "Turtlebot4"]);
    let sent = salma.publish(&["Turtlebot4/cmd_vel", TWIST, "-o", "json"]).ok().json();
    for from in ["0", "1"] {
        let heard = salma.json(&["echo", "Turtlebot4/cmd_vel", "--from", from, "--count", "1"]);
        assert_eq!(heard["height"], sent["height"]);
    }
}

/// Its exit code and what it said on standard error.
fn ended(mut child: Child) -> (Option<i32>, String) {
    let done = eventually("echo ends", || child.try_wait().unwrap());
    (done.code(), std::io::read_to_string(child.stderr.take().unwrap()).unwrap())
}

#[test]
fn who_loses_the_right_to_read_is_told_while_nothing_happens() {
    let dev = Dev::start();
    let salma = dev.user("Salma", &["Turtlebot4"], "ed25519");
    let farhad = dev.user("Farhad", &["Turtlebot4"], "ed25519");
    let listening = |who: &crate::support::Ctl| {
        let mut command = who.command(&["echo", "Turtlebot4/cmd_vel"]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let listeners = |count: u64| {
        eventually("the subscriptions are there", || {
            (dev.admin().json(&["status"])["subscribers"] == count).then_some(())
        });
    };
    let revoked = listening(&farhad);
    listeners(1);
    dev.admin().run(&["identity", "revoke", "Farhad"]).ok();
    let (code, said) = ended(revoked);
    assert!(code == Some(2) && said.contains("LGR-2004"), "{code:?} {said}");

    let echo = listening(&salma);
    listeners(1);
    dev.owner().run(&["robot", "set", "Turtlebot4", "attr-required=licence"]).ok();
    let (code, said) = ended(echo);
    assert!(code == Some(2) && said.contains("LGR-3001") && said.contains("licence=true"), "{code:?} {said}");
    assert_eq!(denied(&dev, "Org1/Salma")["code"], "LGR-3001");
    listeners(0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_subscription_from_the_future_hears_of_no_height_that_does_not_exist() {
    let fleet = Fleet::found(1);
    let admin = fleet.owner();
    let mut node = fleet.nodes[0].start();
    let owner = connect(&admin).await;
    register_robots(&owner, "exclusive").await;
    let request = SubscribeRequest { from_height: 1_000_000, heartbeat_ms: 50, ..SubscribeRequest::default() };
    let mut gateway = GatewayClient::new(wire::channel(&admin, true).await);
    let mut heard = gateway.subscribe(request).await.unwrap().into_inner();
    for _ in 0..3 {
        let beat = tokio::time::timeout(PATIENCE, heard.message()).await.expect("no heartbeat").unwrap().unwrap();
        let height = owner.status().await.unwrap().height;
        assert!(beat.events.is_empty() && (1..=height).contains(&beat.height), "{} of {height}", beat.height);
    }
    node.interrupt();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn subscriptions_to_what_does_not_exist_are_refused_with_what_does() {
    let fleet = Fleet::found(1);
    let admin = fleet.owner();
    let mut node = fleet.nodes[0].start();
    let owner = connect(&admin).await;
    register_robots(&owner, "exclusive").await;
    let wanted = |chaincode: &str, subject: &str, name: &str| Subscription {
        chaincode: chaincode.into(),
        subjects: Some(subject.to_owned()).filter(|subject| !subject.is_empty()).into_iter().collect(),
        names: vec![name.into()],
        ..Subscription::default()
    };
    for (wanted, code, hint) in [
        (wanted("abac", "", "mesage"), Code::BadArgument, "message"),
        (wanted("", "", "mesage"), Code::BadArgument, "message"),
        (wanted("acab", "", "message"), Code::UnknownChaincode, "abac"),
        (wanted("abac", "Huskey/cmd_vel", "message"), Code::UnknownRobot, "Husky"),
        (wanted("abac", "Husky/arm", "message"), Code::UnknownService, "Husky/cmd_vel"),
        (wanted("", "Husky/arm", "message"), Code::UnknownService, "Husky/cmd_vel"),
    ] {
        let refused = owner.subscribe(wanted.clone()).open().await.unwrap_err();
        assert!(refused.code == code && refused.to_string().contains(hint), "{wanted:?}: {refused}");
    }
    node.interrupt();
}

/// Opens subscriptions, each over a connection of its own, until the node refuses; the reason.
async fn take_all_places(
    who: &Context,
    taken: &mut Vec<tonic::Streaming<ledger_api::v1::Delivery>>,
) -> ledger_base::rejection::Rejection {
    loop {
        let mut gateway = GatewayClient::new(wire::channel(who, true).await);
        match gateway.subscribe(SubscribeRequest::default()).await {
            Ok(stream) => taken.push(stream.into_inner()),
            Err(status) => return from_status(&who.nodes[0], &status),
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn members_who_take_all_the_places_they_can_keep_neither_others_nor_robots_out() {
    let fleet = Fleet::found(1);
    let people: Vec<_> = (0..6).map(|n| fleet.issue("Org1", &format!("P{n}"), Role::Member, &[])).collect();
    let (salma, husky) =
        (fleet.issue("Org1", "Salma", Role::Member, &[]), fleet.issue("Org2", "Husky", Role::Robot, &[]));
    fleet.nodes[0].configure("[limits]\nsubscribers_max = 16");
    let mut node = fleet.nodes[0].start();
    let _up = connect(&salma).await;

    let mut taken = Vec::new();
    let refused = take_all_places(&people[0], &mut taken).await;
    assert_eq!((refused.code, taken.len()), (Code::Overloaded, 6), "half of what people may have: {refused}");
    assert!(refused.message.contains("Org1/P0"), "{refused}");
    let quick = async |who: &Context| {
        let options = Options { deadline: std::time::Duration::from_secs(5), ..Options::default() };
        let client = Client::connect_with(who.nodes.clone(), who.credentials().unwrap(), options).await?;
        let mut stream = client.subscribe(Subscription::default());
        stream.open().await.map(|()| stream)
    };
    drop(quick(&salma).await.expect("there is a place for somebody else"));
    for person in &people[1..] {
        take_all_places(person, &mut taken).await;
    }
    let before = Instant::now();
    let Err(refused) = quick(&salma).await else { panic!("people have a quarter less than all") };
    assert!(refused.code == Code::Overloaded && refused.wanted.contains("robots"), "{refused}");
    assert!(before.elapsed() < PATIENCE, "who waits for a place is told that there is none");
    let _robot = quick(&husky).await.expect("places are kept for robots");

    drop(taken);
    until("the places come back", || async { quick(&salma).await.ok() }).await;
    node.interrupt();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn costly_questions_of_one_identity_keep_no_other_reader_waiting() {
    const CONNECTIONS: usize = 4;
    const QUESTIONS: usize = 250;
    const ASKED: usize = 10;
    let fleet = Fleet::found(1);
    let nadia = fleet.issue("Org1", "Nadia", Role::Member, &["Husky"]);
    let owner = fleet.owner();
    let _node = fleet.nodes[0].start();
    let admin = connect(&owner).await;
    register_robots(&admin, "exclusive").await;
    let many: Vec<_> = (0..100)
        .map(|number| {
            let services = json!([{"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"}]);
            Bytes::from(
                json!({"name": format!("Fleet{number}"), "attribute_required": "Fleet", "trusted": ["Org1", "Org2"], "services": services})
                    .to_string(),
            )
        })
        .collect();
    for some in many.chunks(50) {
        admin.invoke("abac", "setup", some.to_vec()).await.unwrap();
    }
    // A reader on a thread of its own, which asks in the middle of them.
    let answered = Arc::new(AtomicUsize::new(0));
    let (ready, is_ready) = std::sync::mpsc::channel();
    let others = Arc::clone(&answered);
    let reader = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let reader = runtime.block_on(connect(&nadia));
        ready.send(()).unwrap();
        while others.load(Ordering::Relaxed) < CONNECTIONS * QUESTIONS / 5 {
            std::thread::yield_now();
        }
        // Of the others that are answered meanwhile. A question during which the machine stalls says nothing.
        let mut meanwhile: Vec<_> = (0..ASKED)
            .map(|_| {
                let before = others.load(Ordering::Relaxed);
                runtime.block_on(reader.query_at(0, "abac", "robot", vec!["Husky".into()])).unwrap();
                others.load(Ordering::Relaxed) - before
            })
            .collect();
        meanwhile.sort_unstable();
        meanwhile[ASKED / 2]
    });
    is_ready.recv().unwrap();

    // All robots, again and again, over several connections of one identity.
    let mut curious = Vec::new();
    for _ in 0..CONNECTIONS {
        let client = connect(&owner).await;
        for _ in 0..QUESTIONS {
            let (client, answered) = (client.clone(), Arc::clone(&answered));
            curious.push(tokio::spawn(async move {
                client.query_at(0, "abac", "robots", Vec::new()).await.unwrap();
                answered.fetch_add(1, Ordering::Relaxed);
            }));
        }
    }
    let meanwhile = tokio::task::spawn_blocking(|| reader.join().unwrap()).await.unwrap();
    for one in curious {
        one.await.unwrap();
    }
    assert!(meanwhile < 12, "{meanwhile} of the others were answered before one of the reader");
}
