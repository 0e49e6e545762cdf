//! An elected leader that orders data and withholds control calls, and a member that tries to have an honest one deposed.

use crate::support::network::{NodeWish, free_address, message, now, register_robots};
use crate::support::{Fleet, Process, connect, until};
use ledger_api::{Client, Context};
use ledger_identity::Role;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Three voters of three organisations, and a learner.
struct Scene {
    fleet: Fleet,
    nodes: Vec<Process>,
    owner: Context,
    salma: Context,
}

impl Scene {
    /// The first node withholds control calls when it leads.
    async fn begin(withholds: bool) -> Self {
        let wish = |name: &str, organisation: &str, voter| NodeWish {
            name: name.into(),
            organisation: organisation.into(),
            voter,
            address: free_address(),
        };
        let voters = [wish("a", "Org1", true), wish("b", "Org2", true), wish("c", "Org3", true)];
        let fleet = Fleet::found_with(&voters, now());
        let (owner, salma) = (fleet.owner(), fleet.issue("Org1", "Salma", Role::Member, &["Turtlebot4"]));
        let start = |(at, place): (usize, &crate::support::network::NodePlace)| {
            let mut command = place.command();
            if withholds && at == 0 {
                command.env("LEDGERD_TEST_WITHHOLDS_CONTROL", "1");
            }
            place.start_as(command)
        };
        let nodes = fleet.nodes.iter().enumerate().map(start).collect();
        let scene = Self { fleet, nodes, owner, salma };
        register_robots(&scene.client(&scene.owner, 1).await, "exclusive").await;
        scene
    }

    fn at(&self, person: &Context, node: usize) -> Context {
        Context { nodes: vec![self.fleet.nodes[node].address.clone()], ..person.clone() }
    }

    async fn client(&self, person: &Context, node: usize) -> Client {
        connect(&self.at(person, node)).await
    }

    /// Makes the first node the leader.
    async fn elect_the_first(&self) -> u64 {
        let owner = self.client(&self.owner, 1).await;
        until("the first node leads", || async {
            let _asked = owner.transfer_leadership(1).await;
            let status = owner.status().await.ok()?;
            (status.leader_id == 1).then_some(status.term)
        })
        .await
    }

    fn end(mut self) {
        for node in &mut self.nodes {
            node.check();
            node.no_panic();
            node.interrupt();
        }
    }

    fn says(&self, node: usize, words: &str) -> bool {
        self.nodes[node].stderr().contains(words)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_that_withholds_a_stop_and_a_revocation_is_deposed_and_both_are_in_force() {
    let scene = Scene::begin(true).await;
    let (owner, salma) = (scene.client(&scene.owner, 1).await, scene.client(&scene.salma, 2).await);
    salma.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await.unwrap();
    let admin = connect(&scene.at(&scene.fleet.issue("Org2", "Boss", Role::Admin, &[]), 1)).await;
    admin.register("Farhad", Role::Member, &BTreeMap::new()).await.unwrap();
    let term = scene.elect_the_first().await;

    // Data goes on, so the leader orders other things.
    let ends = Arc::new(AtomicBool::new(false));
    let traffic = tokio::spawn({
        let ends = Arc::clone(&ends);
        async move {
            for number in 1.. {
                if ends.load(Ordering::Relaxed) {
                    return;
                }
                let _stopped = salma.invoke("abac", "set", message(1, number, b"go on")).await;
                tokio::time::sleep(std::time::Duration::from_millis(20)).await;
            }
        }
    });
    let stop = owner.invoke("abac", "stop", vec!["Turtlebot4".into(), "smoke".into()]);
    let revoke = admin.revoke_identity("Farhad", "lost");
    let (stopped, revoked) = tokio::join!(stop, revoke);
    stopped.unwrap();
    revoked.unwrap();
    let status = owner.status().await.unwrap();
    assert!(status.leader_id != 1 && status.term > term, "node {} leads in term {}", status.leader_id, status.term);
    assert!((1..3).any(|node| scene.says(node, "voters have deposed the leader")));
    // Each voter that has counted the complaints shows it.
    let shown = until("a voter shows the deposition", || async {
        let mut statuses = Vec::new();
        for node in 1..3 {
            statuses.push(scene.client(&scene.owner, node).await.status().await.ok()?);
        }
        statuses.into_iter().find(|status| status.depositions > 0)
    })
    .await;
    let warned = shown.attention.iter().find(|item| item.check == "leader").unwrap();
    assert!(warned.severity == "warning" && warned.message.contains("voters deposed Org1/a"), "{warned:?}");
    ends.store(true, Ordering::Relaxed);
    traffic.await.unwrap();
    scene.end();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_member_that_floods_control_calls_over_all_nodes_deposes_nobody() {
    let scene = Scene::begin(false).await;
    let term = scene.elect_the_first().await;
    let mut floods = Vec::new();
    for node in 0..3 {
        let client = scene.client(&scene.salma, node).await;
        floods.push(tokio::spawn(async move {
            for _ in 0..150 {
                let _either = client.invoke("abac", "acquire", vec!["Turtlebot4".into(), "600000".into()]).await;
                let _either = client.invoke("abac", "release", vec!["Turtlebot4".into()]).await;
            }
        }));
    }
    for flood in floods {
        flood.await.unwrap();
    }
    let status = scene.client(&scene.owner, 1).await.status().await.unwrap();
    assert_eq!((status.leader_id, status.term), (1, term));
    assert!(!(0..3).any(|node| scene.says(node, "deposed")));
    scene.end();
}
