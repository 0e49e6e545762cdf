//! A disk that is full, under one voter and under the leader. The node turns read-only before it corrupts, the others go
//! on, and with space it catches up by itself.

use crate::audit::audit;
use crate::cluster::{Cluster, VOTERS};
use crate::load::Load;
use crate::rounds;
use crate::support::network::message;
use crate::support::small_disk::{SmallDisk, fill};
use crate::support::wait::PATIENCE;
use crate::support::{until, wire};
use ledger_api::{Call, Context};
use ledger_base::rejection::Code;
use std::process::Command;
use std::sync::Arc;

/// Bytes of the messages that fill the log of the node without space.
const LARGE_BYTES: usize = 100_000;

/// The answer of one node to a transaction that is submitted to it alone: the code of the verdict.
async fn told_by(cluster: &Cluster, node: usize, number: u64) -> u32 {
    let place = vec![cluster.fleet.nodes[node].address.clone()];
    let guest = Context { nodes: place, ..cluster.guest.clone() };
    let client = cluster.client_at(&guest, node).await;
    let args = message(0, number, &vec![0; LARGE_BYTES]);
    let call = Call { chaincode: "abac".into(), function: "set".into(), args, ttl: PATIENCE };
    let transaction = client.prepare(call).unwrap();
    let line = wire::channel(&guest, true).await;
    let answer = tokio::time::timeout(PATIENCE, wire::submit(&line, transaction.encoded().clone()));
    wire::code(&answer.await.expect("an answer").unwrap())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_voter_or_a_leader_with_a_full_disk_turns_read_only_and_the_others_go_on() {
    let mut cluster = Cluster::found();
    // All three, so that whoever leads has a disk that can be filled.
    let disks: Vec<_> =
        (0..VOTERS).map(|node| Arc::new(SmallDisk::under(&cluster.fleet.nodes[node], cluster.fleet.path()))).collect();
    for (node, disk) in disks.iter().enumerate() {
        let disk = Arc::clone(disk);
        cluster.surround(node, Box::new(move |command: Command| disk.enter(&command)));
    }
    cluster.run("open").await;
    let load = Load::start(&cluster).await;
    load.more("before the first fault", 20, &mut cluster).await;
    let (mut full, mut full_leaders, mut number) = (0, 0, 0);
    for round in 0..2 * rounds() {
        let (leader, _) = cluster.leader_among(&[0, 1, 2]).await;
        let victim = if round % 2 == 0 { (leader + 1) % VOTERS } else { leader };
        let ballast = disks[victim].seen(&cluster.fleet.nodes[victim].data).join("ballast");
        fill(&ballast);
        full += 1;
        full_leaders += u64::from(victim == leader);
        // It says so, and takes nothing more from clients.
        until("the node without space refuses", || {
            number += 1;
            let (cluster, number) = (&cluster, number);
            async move { (told_by(cluster, victim, number).await == u32::from(Code::DiskFull.number())).then_some(()) }
        })
        .await;
        // Reading goes on there, writing elsewhere: enough to need space that it does not have.
        cluster.observer(victim).query_at(1, "abac", "robots", vec![]).await.unwrap();
        let elsewhere = cluster.client_from(&cluster.guest, (victim + 1) % VOTERS).await;
        for _ in 0..60 {
            number += 1;
            elsewhere.invoke("abac", "set", message(0, number, &vec![1; LARGE_BYTES])).await.unwrap();
        }
        load.more(&format!("round {round}: without space on node {}", victim + 1), 30, &mut cluster).await;
        std::fs::remove_file(&ballast).unwrap();
        let height = cluster.observer((victim + 1) % VOTERS).status().await.unwrap().height;
        until("the node with space again has caught up", || async {
            (cluster.status(victim).await?.height >= height).then_some(())
        })
        .await;
        until("the node with space again takes transactions", || {
            number += 1;
            let (cluster, number) = (&cluster, number);
            async move { (told_by(cluster, victim, number).await == 0).then_some(()) }
        })
        .await;
        load.more(&format!("round {round}: after space came back"), 20, &mut cluster).await;
    }
    let told = load.finish().await;
    audit(&mut cluster, &told).await;
    println!(
        "faults injected: {full} full disks, {full_leaders} of leaders; {} acknowledged transactions, refused {:?}",
        told.acknowledged.len(),
        told.refused
    );
    // Users who know other nodes go there.
    assert_eq!(told.refused.get(&Code::DiskFull), None);
    assert!(full > 0 && full_leaders > 0);
}
