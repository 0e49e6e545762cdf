//! Certificates of blocks: signatures of voters of two organisations, and no block without them; and readers that believe
//! nothing else.

use crate::support::network::{NodePlace, NodeWish, free_address, now};
use crate::support::{Fleet, connect, programs, until};
use bytes::Bytes;
use ledger::network::Genesis;
use ledger_api::v1::{Delivery, EventRecord};
use ledger_api::{Client, Context, EventStream, Subscription};
use ledger_base::rejection::Code;
use ledger_identity::Role;
use ledger_light::{Checkpoint, Proof};
use serde_json::json;

fn wish(name: &str, organisation: &str) -> NodeWish {
    NodeWish { name: name.into(), organisation: organisation.into(), voter: true, address: free_address() }
}

/// Registers a robot, which is control state; answers with the height.
async fn robot(owner: &Client, name: &str) -> u64 {
    let services = json!([{"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "mode": "open"}]);
    let robot = json!({"name": name, "attribute_required": name, "services": services}).to_string();
    owner.invoke("abac", "setup", vec![Bytes::from(robot)]).await.unwrap().height
}

/// Checks the newest proof in a data directory by nothing but the genesis: nothing has changed who governs since.
fn check_newest(place: &NodePlace) -> u64 {
    let begun = Genesis::governance(&std::fs::read(place.data.join("genesis.json")).unwrap()).unwrap();
    let bytes = std::fs::read(place.data.join("certificates/newest.proof")).unwrap();
    begun.check(&Proof::from_bytes(&bytes).unwrap().certificate).unwrap();
    Proof::from_bytes(&bytes).unwrap().certificate.statement.height
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_voters_of_two_organisations_execute_is_certified_and_nothing_that_one_of_them_misses() {
    let fleet = Fleet::found_with(&[wish("node1", "Org1"), wish("node2", "Org2"), wish("node3", "Org1")], now());
    for place in &fleet.nodes {
        place.configure("[order]\nattest_ms = 100");
    }
    let owner = fleet.owner();
    fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let at = async |node: usize, person: &Context| {
        connect(&Context { nodes: vec![fleet.nodes[node].address.clone()], ..person.clone() }).await
    };
    let mut nodes: Vec<_> = fleet.nodes.iter().map(NodePlace::start).collect();
    let client = at(0, &owner).await;
    let first = robot(&client, "Turtlebot4").await;
    for node in 0..3 {
        let asked = at(node, &owner).await;
        until("the robot is certified at each node", || async {
            (asked.status().await.ok()?.certified >= first).then_some(())
        })
        .await;
    }
    let shown = fleet.ctl().as_("Salma").run(&["status", "-o", "json"]).ok().json();
    assert!(shown["certified"].as_u64().unwrap() >= first && shown.get("lies").is_none(), "{shown}");

    // Only voters of Org1 are left: they order and execute, and nobody certifies.
    nodes[1].kill();
    let alone = robot(&client, "Husky").await;
    let later = until("attestations follow", || async {
        let status = client.status().await.ok()?;
        (status.height > alone + 1).then_some(status)
    })
    .await;
    assert!(later.certified < alone, "{} of {alone}", later.certified);
    nodes[1] = fleet.nodes[1].start();
    for node in 0..3 {
        let asked = at(node, &owner).await;
        until("the other organisation has executed it, too", || async {
            (asked.status().await.ok()?.certified >= alone).then_some(())
        })
        .await;
    }
    nodes.iter_mut().for_each(|node| node.interrupt());
    for place in &fleet.nodes {
        assert!(check_newest(place) >= 1);
    }
    // A restart knows what was certified.
    let kept = check_newest(&fleet.nodes[0]);
    nodes[0] = fleet.nodes[0].start();
    let status = until("node1 answers alone", || async { at(0, &owner).await.status().await.ok() }).await;
    assert!(status.certified >= kept, "{} after {kept}", status.certified);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_follows_who_governs_from_the_genesis_and_shows_how_a_robot_stands() {
    let fleet = Fleet::found_with(&[wish("node1", "Org1"), wish("node2", "Org2"), wish("node3", "Org1")], now());
    let owner = fleet.owner();
    fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    fleet.issue("Org1", "admin", Role::Admin, &[]);
    let mut nodes: Vec<_> = fleet.nodes.iter().map(NodePlace::start).collect();
    let client = connect(&owner).await;
    let registered = robot(&client, "Turtlebot4").await;
    let ctl = |arguments: &[&str]| fleet.ctl().as_("Salma").run(arguments);
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("fleet.checkpoint").display().to_string();
    let first = ctl(&["light", "Turtlebot4", "--checkpoint", &file, "-o", "json"]).ok().json();
    assert_eq!((&first["robot"], &first["organisation"]), (&json!("Turtlebot4"), &json!("Org2")), "{first}");
    assert!(first["height"].as_u64().unwrap() > registered && first["began_at"] == 0, "{first}");
    let signed = first["signed_by"].as_array().unwrap();
    assert!(signed.len() >= 2 && signed.contains(&json!("Org2/node2")), "{first}");

    // Voters change: node3 becomes a learner. The reader goes on from its checkpoint, and from the genesis.
    fleet.ctl().as_("admin").run(&["network", "demote", "Org1/node3"]).ok();
    until("node3 only follows", || async {
        let peers = client.status().await.ok()?.peers;
        peers.iter().any(|peer| peer.name == "node3" && peer.role == "learner").then_some(())
    })
    .await;
    for (began, arguments) in [
        (first["height"].clone(), vec!["light", "Turtlebot4", "--checkpoint", &file, "-o", "json"]),
        (json!(0), vec!["light", "Turtlebot4", "-o", "json"]),
    ] {
        let shown = ctl(&arguments).ok().json();
        assert_eq!((&shown["voters"], &shown["began_at"]), (&json!(2), &began), "{shown}");
        assert!(shown["strict_since"].is_null(), "two organisations cannot have strict certificates: {shown}");
    }
    let text = ctl(&["light", "Turtlebot4"]).ok().stdout;
    assert!(text.contains("(2 of 2 voters)") && text.contains("the genesis of network"), "{text}");
    assert!(text.contains("no: one lying organisation could have another block certified"), "{text}");
    assert_eq!(ctl(&["light", "Turtlebot5"]).code, 3);

    // A stop is part of what voters sign, and so is its end.
    let stopped = || ctl(&["light", "Turtlebot4", "-o", "json"]).ok().json()["stopped"].clone();
    assert!(first["stopped"].is_null() && text.contains("stopped"), "{first} {text}");
    fleet.ctl().as_("Admin").run(&["stop", "Turtlebot4", "--reason", "smoke"]).ok();
    let stop = stopped();
    assert_eq!((&stop["by"], &stop["reason"]), (&json!("Org2/Admin"), &json!("smoke")), "{stop}");
    let text = ctl(&["light", "Turtlebot4"]).ok().stdout;
    assert!(text.contains("yes, by Org2/Admin") && text.contains(": smoke"), "{text}");
    fleet.ctl().as_("Admin").run(&["resume", "Turtlebot4"]).ok();
    assert!(stopped().is_null());

    let kept = std::fs::read(&file).unwrap();
    std::fs::write(&file, b"ledgerd checkpoint v1\0").unwrap();
    let refused = ctl(&["light", "Turtlebot4", "--checkpoint", &file]);
    assert!(refused.code == 3 && refused.stderr.contains("is not usable"), "{refused:?}");
    nodes.iter_mut().for_each(|node| node.interrupt());

    // An auditor compares a whole chain with what voters had signed.
    let audit = |checkpoint: &[u8]| {
        std::fs::write(&file, checkpoint).unwrap();
        let mut command = programs::node();
        let done = command.arg("verify").arg(&fleet.nodes[0].data).args(["--against", &file]).output().unwrap();
        (done.status.code(), [done.stdout, done.stderr].map(|text| String::from_utf8(text).unwrap()).concat())
    };
    let (code, text) = audit(&kept);
    assert!(code == Some(0) && text.contains("matches what voters signed"), "{text}");
    let block = Checkpoint::from_bytes(&owner.network, &kept).unwrap().proof.certificate.statement.block;
    let at = kept.windows(32).position(|bytes| bytes == block.0).unwrap();
    let mut other = kept;
    other[at] ^= 1;
    let (code, text) = audit(&other);
    assert!(code != Some(0) && text.contains("differs from the block that voters signed"), "{text}");
}

/// The next delivery with events.
async fn happened(events: &mut EventStream) -> Delivery {
    loop {
        let delivery = events.next().await.unwrap();
        if !delivery.events.is_empty() {
            return delivery;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn events_come_with_their_paths_and_a_certificate_to_whoever_asks_for_them() {
    let fleet = Fleet::found_with(&[wish("node1", "Org1"), wish("node2", "Org2"), wish("node3", "Org1")], now());
    // Two of three are the majority, so every signature counts.
    let mut nodes = [fleet.nodes[0].start(), fleet.nodes[1].start()];
    let owner = connect(&Context { nodes: vec![fleet.nodes[0].address.clone()], ..fleet.owner() }).await;
    let wanted = Subscription { chaincode: "abac".into(), names: vec!["robot".into()], ..Subscription::default() };
    let mut unproved = owner.subscribe(wanted.clone());
    let mut proved = owner.subscribe(Subscription { proofs: true, ..wanted });
    unproved.open().await.unwrap();
    proved.open().await.unwrap();
    // On a busy machine the signatures for one may come too late.
    let mut tries = 0;
    let told = loop {
        tries += 1;
        let name = format!("Turtlebot{tries}");
        let height = robot(&owner, &name).await;
        assert!(owner.believe(None, &happened(&mut unproved).await).await.unwrap().is_none());
        let told = happened(&mut proved).await;
        assert_eq!((told.height, told.events[0].subject.as_str()), (height, name.as_str()));
        if !told.proof.is_empty() {
            break told;
        }
        assert!(tries < 20, "no event comes with a proof");
    };
    let height = told.height;
    let checkpoint = owner.believe(None, &told).await.unwrap().expect("a proof");
    assert_eq!(checkpoint.governance.height(), height);

    // Whatever a node changes about it is not believed, from the genesis and from where the reader stands.
    let event = |change: &dyn Fn(&mut EventRecord)| {
        let mut changed = told.clone();
        change(&mut changed.events[0]);
        changed
    };
    let lies = [
        event(&|event| event.subject = "Husky".into()),
        event(&|event| event.name = "stopped".into()),
        event(&|event| event.payload = Bytes::from_static(b"{}")),
        Delivery { height: height + 1, ..told.clone() },
        Delivery { time: told.time + 1, ..told.clone() },
        Delivery { block_hash: Bytes::from_static(&[7; 32]), ..told.clone() },
    ];
    for (number, lie) in lies.iter().enumerate() {
        for known in [None, Some(&checkpoint.governance)] {
            let refused = owner.believe(known, lie).await.map(drop).unwrap_err();
            assert_eq!(refused.code, Code::Untrusted, "{number}: {refused}");
        }
    }
    for at in 0..told.proof.len() {
        let mut proof = told.proof.to_vec();
        proof[at] ^= 1;
        let changed = Delivery { proof: proof.into(), ..told.clone() };
        assert!(owner.believe(Some(&checkpoint.governance), &changed).await.is_err(), "byte {at}");
    }

    // Where one organisation is alone nobody certifies: the event comes all the same, without a proof.
    nodes[1].kill();
    let _third = fleet.nodes[2].start();
    let alone = robot(&owner, "Husky").await;
    let told = happened(&mut proved).await;
    assert_eq!((told.height, told.proof.len()), (alone, 0));
}
