//! Members that abuse their rights: what they may do to others is little, and they are told so.

use crate::support::network::{NodeWish, free_address, message, now, register_robots};
use crate::support::process::Process;
use crate::support::{Fleet, connect, until};
use ledger_api::{Client, Context};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use serde_json::json;
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

fn wish(name: &str, organisation: &str, voter: bool) -> NodeWish {
    NodeWish { name: name.into(), organisation: organisation.into(), voter, address: free_address() }
}

/// Three voters of Org1, and a learner of Org2 at the end.
fn found() -> (Fleet, Vec<Process>) {
    let voters = ["node1", "node2", "node3"].map(|name| wish(name, "Org1", true));
    let wishes: Vec<_> = voters.into_iter().chain([wish("node4", "Org2", false)]).collect();
    let fleet = Fleet::found_with(&wishes, now());
    fleet.nodes.iter().for_each(|place| place.configure("[order]\nattest_ms = 100"));
    let nodes = fleet.nodes.iter().map(|place| place.start()).collect();
    (fleet, nodes)
}

async fn at(fleet: &Fleet, node: usize, person: &Context) -> Client {
    connect(&Context { nodes: vec![fleet.nodes[node].address.clone()], ..person.clone() }).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn leadership_moves_on_demand_of_organisations_with_voters_and_not_often() {
    let (fleet, mut nodes) = found();
    let (owner, boss) = (fleet.owner(), fleet.issue("Org1", "Boss", Role::Admin, &[]));
    let (stranger, boss) = (at(&fleet, 3, &owner).await, at(&fleet, 0, &boss).await);
    // On a busy machine somebody else may lead meanwhile, though not because of this.
    until("ten demands in one term are refused, and nobody else leads", || async {
        let status = stranger.status().await.ok()?;
        if status.leader_id == 0 {
            return None;
        }
        for _ in 0..10 {
            let refused = stranger.transfer_leadership(0).await.unwrap_err();
            if matches!(refused.code, Code::NoLeader | Code::Timeout) {
                return None;
            }
            assert_eq!(refused.code, Code::NotAdmin, "{refused}");
            assert!(refused.found.contains("Org2") && refused.wanted.contains("Org1"), "{refused}");
        }
        (stranger.status().await.ok()?.term == status.term).then_some(())
    })
    .await;

    let begun = Instant::now();
    let (mut done, mut refused_in_time) = (0, 0);
    while done < 2 {
        match boss.transfer_leadership(0).await {
            Ok(_) => done += 1,
            Err(refused) if refused.code == Code::Overloaded => {
                assert!(refused.wanted.contains("10 s") && refused.advice().contains("try again in"), "{refused}");
                refused_in_time += 1;
            }
            // A voter has just come up, or hears of the new leader in a moment.
            Err(refused) => assert!(matches!(refused.code, Code::NoLeader | Code::Timeout), "{refused}"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let seconds = begun.elapsed().as_secs();
    assert!(done <= 1 + seconds / 10, "{done} transfers in {seconds} s");
    assert!(refused_in_time > 0);
    nodes.iter_mut().for_each(Process::check);
}

/// A node of Org2 that no process is: a certificate, and what somebody does with it.
async fn puppet(fleet: &Fleet, name: &str) -> Client {
    at(fleet, 0, &fleet.issue("Org2", name, Role::Node, &[])).await
}

async fn join(puppet: &Client, address: &str) -> Result<(), Rejection> {
    puppet.invoke("msp", "join_node", vec![json!({"address": address}).to_string().into()]).await.map(drop)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_address_that_never_answers_is_dialled_less_and_less_and_some_are_never_registered() {
    let (fleet, mut nodes) = found();
    let stranger = puppet(&fleet, "puppet").await;
    for address in ["169.254.169.254:80", "[fe80::1]:7450", "224.0.0.251:5353", "0.0.0.0:7450", "2852039166:80"] {
        let refused = join(&stranger, address).await.unwrap_err();
        assert_eq!(refused.code, Code::BadArgument, "{address}: {refused}");
    }
    // A privileged port is registered, and no node of another organisation dials it.
    let guest = puppet(&fleet, "guest").await;
    join(&guest, "127.0.0.1:22").await.unwrap();
    until("a node of another organisation says why it does not dial", || async {
        nodes.iter().any(|node| node.stderr().contains("127.0.0.1:22, a privileged port")).then_some(())
    })
    .await;
    // Somebody else's port: it takes every connection, and answers none.
    let victim = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = victim.local_addr().unwrap().to_string();
    let dials = Arc::new(AtomicU64::new(0));
    std::thread::spawn({
        let dials = Arc::clone(&dials);
        move || {
            for _connection in victim.incoming() {
                dials.fetch_add(1, Ordering::Relaxed);
            }
        }
    });
    join(&stranger, &address).await.unwrap();
    let begun = Instant::now();
    until("every node has dialled it", || async { (dials.load(Ordering::Relaxed) >= 4).then_some(()) }).await;
    tokio::time::sleep(Duration::from_secs(15)).await;
    // Each pause is twice as long as the one before, from 50 ms on.
    let each = f64::log2(begun.elapsed().as_secs_f64() / 0.05).ceil() + 2.0;
    let dials = dials.load(Ordering::Relaxed) as f64;
    assert!(dials <= 4.0 * each, "{dials} dials by four nodes, at most {each} by each");
    nodes.iter_mut().for_each(Process::check);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nodes_that_attest_nonsense_are_shown_and_stop_nobody_however_many_they_are() {
    let (fleet, mut nodes) = found();
    let owner = at(&fleet, 0, &fleet.owner()).await;
    register_robots(&owner, "open").await;
    let zero = Hash::ZERO;
    for name in ["liar1", "liar2", "liar3", "liar4", "liar5"] {
        let liar = puppet(&fleet, name).await;
        join(&liar, &free_address()).await.unwrap();
        let height = liar.status().await.unwrap().height;
        let nonsense = json!({"height": height, "hash": zero.to_string(), "digest": zero.to_string()}).to_string();
        liar.invoke("msp", "attest", vec![nonsense.into()]).await.unwrap();
    }
    for node in 0..4 {
        let observer = at(&fleet, node, &fleet.owner()).await;
        until("every node shows who differs", || async {
            let differs = observer.status().await.ok()?.divergence;
            differs.contains("Org2/liar1 has another block at height").then_some(())
        })
        .await;
    }
    // They have asked each other by now, at least once more, and go on.
    let boss = at(&fleet, 0, &fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"])).await;
    tokio::time::sleep(Duration::from_secs(3)).await;
    boss.invoke("abac", "set", message(0, 1, b"forwards")).await.unwrap();
    nodes.iter_mut().for_each(Process::check);
    // Who has left is shown no more.
    for name in ["liar1", "liar2", "liar3", "liar4", "liar5"] {
        let leave = json!({"organisation": "Org2", "name": name, "role": "removed"}).to_string();
        owner.invoke("msp", "set_node_role", vec![leave.into()]).await.unwrap();
    }
    for node in 0..4 {
        let observer = at(&fleet, node, &fleet.owner()).await;
        until("nobody differs", || async { observer.status().await.ok()?.divergence.is_empty().then_some(()) }).await;
    }
    nodes.iter_mut().for_each(Process::check);
}
