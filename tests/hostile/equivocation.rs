//! A voter that signs different things for one place, each for one node only. This test is that voter: it has its key.

use crate::pretenders::{as_node, found, part, say};
use crate::support::network::{NodePlace, register_robots};
use crate::support::{Fleet, Process, connect, until};
use bytes::Bytes;
use ledger_api::v1::StatusResponse;
use ledger_api::{Client, Context};
use ledger_base::hash::Hash;
use ledger_light::{Misbehaviour, Signed, Statement};
use std::path::PathBuf;

const STATEMENT: u64 = 6;
const EVIDENCE: u64 = 14;

/// Nodes a of Org1 and c of Org2 run; b of Org1, a voter, is this test.
struct Scene {
    fleet: Fleet,
    nodes: Vec<Process>,
    clients: Vec<Client>,
    owner: Context,
    liar: Context,
}

impl Scene {
    async fn begin() -> Self {
        let fleet = found();
        let owner = fleet.owner();
        let nodes: Vec<Process> = [0, 2].map(|node| fleet.nodes[node].start()).into();
        let mut clients = Vec::new();
        for node in [0, 2] {
            clients.push(connect(&Context { nodes: vec![fleet.nodes[node].address.clone()], ..owner.clone() }).await);
        }
        register_robots(&clients[0], "exclusive").await;
        let liar = as_node(&fleet.nodes[1], &owner);
        Self { fleet, nodes, clients, owner, liar }
    }

    /// A height that both nodes have executed and certified.
    async fn certified(&self) -> u64 {
        until("both nodes have certified a block", || async {
            let mut least = u64::MAX;
            for client in &self.clients {
                least = client.status().await.ok()?.certified.min(least);
            }
            // Both still hold what was certified just now.
            (least > 0).then_some(least)
        })
        .await
    }

    fn signed(&self, node: u64, height: u64, block: u8, results: u8) -> Signed {
        let voter = as_node(&self.fleet.nodes[node as usize - 1], &self.liar);
        let statement = Statement {
            network: self.liar.network,
            recoveries: 0,
            height,
            time: crate::support::network::now(),
            block: Hash([block; 32]),
            results: Hash([results; 32]),
        };
        statement.sign(node, Bytes::copy_from_slice(&voter.chain[0]), &voter.key).unwrap()
    }

    async fn send(&self, to: &NodePlace, field: u64, bytes: &[u8]) {
        say(&self.liar, &to.address, vec![part(field, &part(1, bytes)).into()]).await;
    }

    /// Waits until the statuses of both nodes say this.
    async fn both(&self, what: &str, says: impl Fn(&StatusResponse) -> bool) {
        for client in &self.clients {
            until(what, || async { client.status().await.ok().filter(|status| says(status)).map(drop) }).await;
        }
    }

    /// The files of a node with the proofs of this kind.
    fn proofs(&self, node: usize, suffix: &str) -> Vec<PathBuf> {
        let files = std::fs::read_dir(self.fleet.nodes[node].data.join("certificates")).unwrap();
        let files = files.map(|file| file.unwrap().path());
        files.filter(|file| file.to_str().unwrap().ends_with(suffix)).collect()
    }

    fn end(mut self) {
        for node in &mut self.nodes {
            node.check();
            node.no_panic();
            node.interrupt();
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_voter_that_signs_two_blocks_each_for_one_node_is_named_by_both() {
    let scene = Scene::begin().await;
    let height = scene.certified().await;
    for (node, block) in [(0, 8), (2, 9)] {
        let signed = scene.signed(2, height, block, 7).to_bytes();
        scene.send(&scene.fleet.nodes[node], STATEMENT, &signed).await;
    }
    let named = format!("Org1/b signed two different blocks of height {height}");
    scene.both("both name the liar", |status| status.lies == named && status.faults.is_empty()).await;
    let shown = scene.fleet.ctl().run(&["network", "status"]);
    assert!(shown.stdout.contains(&named), "{shown:?}");
    until("both keep the proof", || async {
        [0, 2].iter().all(|at| scene.proofs(*at, ".lie").len() == 1).then_some(())
    })
    .await;
    // A second lie adds nothing.
    let other = scene.signed(2, height, 10, 7).to_bytes();
    scene.send(&scene.fleet.nodes[0], STATEMENT, &other).await;
    scene.both("nothing else is named", |status| status.lies == named).await;
    // A node that was away learns of it.
    let mut scene = scene;
    scene.nodes.push(scene.fleet.nodes[3].start());
    let owner = scene.owner.clone();
    scene.clients.push(connect(&Context { nodes: vec![scene.fleet.nodes[3].address.clone()], ..owner }).await);
    scene.both("the learner names it, too", |status| status.lies == named).await;

    // Its vote ends by the proof: of two organisations the other one decides.
    let proof = scene.proofs(0, ".lie").remove(0);
    let file = proof.to_str().unwrap();
    scene.fleet.ctl().run(&["network", "remove", "Org1/b", "--proof", file]).ok();
    scene.both("a former member is named no more", |status| status.lies.is_empty() && status.voters == 2).await;
    scene.end();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_results_of_one_block_are_a_fault_and_the_node_that_has_signed_them_stops_once() {
    let mut scene = Scene::begin().await;
    let height = scene.certified().await;
    for (node, results) in [(0, 8), (2, 9)] {
        let signed = scene.signed(2, height, 7, results).to_bytes();
        scene.send(&scene.fleet.nodes[node], STATEMENT, &signed).await;
    }
    let named = format!("Org1/b signed two different results of block {height}");
    scene
        .both("both show the fault, and call nobody a liar", |status| status.faults == named && status.lies.is_empty())
        .await;

    // The proof that node c has a fault stops node c, and only once.
    let [first, second] = [8, 9].map(|results| scene.signed(3, height, 7, results));
    let proof = Misbehaviour::of(first, second).unwrap().to_bytes();
    scene.send(&scene.fleet.nodes[2], EVIDENCE, &proof).await;
    let mut stopped = scene.nodes.pop().unwrap();
    assert!(!stopped.wait().success());
    assert!(
        stopped.stderr().contains("this node has signed two different results of one block"),
        "{}",
        stopped.stderr()
    );
    scene.nodes.push(scene.fleet.nodes[2].start());
    scene.both("node c is back, and a leader is there", |status| status.leader_id > 0).await;
    scene.send(&scene.fleet.nodes[2], EVIDENCE, &proof).await;
    let faults = format!("{named}, Org2/c signed two different results of block {height}");
    scene.both("it runs on, and all show it", |status| status.faults == faults).await;
    scene.end();
}
