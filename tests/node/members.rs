//! The life of nodes while traffic runs: they join, vote, lead, are demoted and removed, and their places are taken by
//! others. The leader brings the members to what the ledger says.

use crate::join::{Newcomer, follows, id, token};
use crate::support::network::register_robots;
use crate::support::{Fleet, connect, until};
use ledger::msp::Decision;
use ledger_api::{Client, Context};
use ledger_identity::Role;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

async fn decide(client: &Client, function: &str, argument: String) -> Decision {
    let done = client.invoke("msp", function, vec![argument.into()]).await.unwrap();
    serde_json::from_slice(&done.response).unwrap()
}

/// The role of a node as another one sees it.
async fn becomes(observer: &Client, node: u64, role: &str) {
    until(&format!("node {node} is {role:?}"), || async {
        let status = observer.status().await.ok()?;
        let found = status.peers.iter().find(|peer| peer.node_id == node).map_or("gone", |peer| peer.role.as_str());
        (found == role).then_some(())
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nodes_join_vote_lead_and_leave_while_traffic_runs() {
    let fleet = Fleet::found(1);
    let (admin, owner) = (fleet.issue("Org1", "Admin", Role::Admin, &[]), fleet.owner());
    let salma = fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]);
    let mut founder = fleet.nodes[0].start();
    let first = connect(&admin).await;
    let newcomer = Newcomer::new(&fleet, "second");
    newcomer.join(&token(&fleet, &first, "Org1", "node2").await.to_string()).ok();
    let second_id = id(&newcomer.data());
    let mut second = newcomer.run("node2", &fleet);
    follows(&admin, &first, &newcomer).await;
    // Another one has joined, and is not there yet.
    let third = Newcomer::new(&fleet, "third");
    let mut invitation = token(&fleet, &first, "Org1", "node3").await;
    invitation.addresses.push(newcomer.address.clone());
    third.join(&invitation.to_string()).ok();
    let third_id = id(&third.data());

    // From now on somebody publishes, through whichever node is there.
    let nodes = vec![fleet.nodes[0].address.clone(), newcomer.address.clone()];
    let everywhere = |person: &Context| Context { nodes: nodes.clone(), ..person.clone() };
    let (admin, owner) = (everywhere(&admin), connect(&everywhere(&owner)).await);
    register_robots(&owner, "open").await;
    let running = Arc::new(AtomicBool::new(true));
    let publishing = tokio::spawn({
        let (running, salma) = (Arc::clone(&running), connect(&everywhere(&salma)).await);
        async move {
            let mut done = Vec::new();
            while running.load(Ordering::Relaxed) {
                let message = crate::support::network::message(0, done.len() as u64 + 1, &[]);
                done.push(salma.invoke("abac", "set", message).await.unwrap());
            }
            done
        }
    });

    // It votes as soon as both organisations want it.
    let voter = json!({"id": second_id, "role": "voter"}).to_string();
    let decision = decide(&first, "set_node_role", voter).await;
    assert!(!decision.executed && decision.pending == ["Org2"]);
    becomes(&first, second_id, "learner").await;
    decide(&owner, "approve", decision.proposal.unwrap().id.to_string()).await;
    becomes(&first, second_id, "voter").await;

    // The founder leads and is to be removed: it hands over first, and the other one goes on alone.
    let there = connect(&Context { nodes: vec![newcomer.address.clone()], ..admin.clone() }).await;
    decide(
        &there,
        "set_node_role",
        json!({"organisation": "Org1", "name": "org1-node", "role": "removed"}).to_string(),
    )
    .await;
    becomes(&there, 1, "gone").await;
    let status = there.status().await.unwrap();
    assert_eq!((status.role.as_str(), status.leader_id), ("leader", second_id));
    assert!(!founder.wait().success(), "it does not serve on from what it knew");
    let mut back = fleet.nodes[0].start();
    assert!(!back.wait().success(), "it does not come back");
    assert_eq!(back.stderr().matches("error: Org1/org1-node was removed").count(), 2, "{}", back.stderr());

    // The genesis of the last one only knows the founder: who let it in tells it the rest.
    let mut last = third.run("node3", &fleet);
    becomes(&there, third_id, "learner").await;
    running.store(false, Ordering::Relaxed);
    let done = publishing.await.unwrap();
    follows(&admin, &there, &third).await;
    for committed in done.iter().rev().take(100) {
        assert_eq!(there.transaction(committed.id).await.unwrap().height, committed.height);
    }
    println!("members: {} transactions", done.len());
    for process in [&mut second, &mut last] {
        process.check();
        process.interrupt();
    }
}
