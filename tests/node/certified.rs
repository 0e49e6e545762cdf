//! Certificates of blocks: signatures of voters of two organisations, and no block without them.

use crate::support::network::{NodePlace, NodeWish, free_address, now};
use crate::support::{Fleet, connect, until};
use bytes::Bytes;
use ledger::network::Genesis;
use ledger_api::{Client, Context};
use ledger_identity::Role;
use ledger_identity::msp::{Msp, Msps};
use ledger_light::{Certificate, Voter, Voters};
use ledger_rejection::Rejection;
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

/// Checks the newest certificate in a data directory by nothing but the genesis.
fn check_newest(place: &NodePlace) -> u64 {
    let (genesis, network) = Genesis::from_bytes(&std::fs::read(place.data.join("genesis.json")).unwrap()).unwrap();
    let mut msps = Msps::new();
    for organisation in &genesis.organisations {
        msps.insert(Msp::new(&organisation.name, &organisation.roots, &[] as &[Bytes]).unwrap()).unwrap();
    }
    let voter = |node: &ledger::network::FoundingNode| {
        (node.id, Voter { organisation: node.organisation.clone(), name: node.name.clone() })
    };
    let nodes = genesis.nodes.iter().map(voter).collect();
    let voters = Voters { nodes, voters: [1, 2, 3].into(), outgoing: [].into() };
    let bytes = std::fs::read(place.data.join("certificates/newest.cert")).unwrap();
    let certificate = Certificate::from_bytes(&bytes).unwrap();
    let identify = |der: &[u8], time: u64| msps.verify(der, &[], time).map_err(Rejection::from);
    certificate.verify(&network, &voters, identify).unwrap();
    certificate.statement.height
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
