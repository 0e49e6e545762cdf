//! Networks that break: between nodes only, in both directions or in one. Clients reach every node, also those that can
//! do nothing for them.

use crate::audit::audit;
use crate::cluster::{Cluster, NODES, VOTERS};
use crate::load::Load;
use crate::own_network::isolated;
use crate::rounds;
use crate::site::Site;
use crate::support::network::message;
use crate::support::wait::PATIENCE;
use crate::support::{Dice, until};
use ledger_api::Call;
use std::future::Future;
use std::time::Duration;

/// Runs a test in a network of its own, with a cluster and users at work.
fn on_a_site<F: Future<Output = ()>>(test: impl FnOnce(Site, Cluster, Load) -> F) {
    on_a_site_with("", test);
}

/// The same with these settings of every node.
fn on_a_site_with<F: Future<Output = ()>>(settings: &str, test: impl FnOnce(Site, Cluster, Load) -> F) {
    if !isolated(&test) {
        return;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async {
        let (site, mut cluster) = Site::build();
        cluster.fleet.nodes.iter().for_each(|place| place.configure(settings));
        cluster.run("open").await;
        let load = Load::start(&cluster).await;
        load.more("before the first fault", 20, &mut cluster).await;
        test(site, cluster, load).await;
    });
}

/// Waits until a node does not lead any more.
async fn steps_down(cluster: &Cluster, node: usize) {
    until(&format!("node {} does not lead any more", node + 1), || async {
        (cluster.status(node).await?.role != "leader").then_some(())
    })
    .await;
}

/// All voters but one.
fn others(node: usize) -> Vec<usize> {
    (0..VOTERS).filter(|other| *other != node).collect()
}

#[test]
fn a_leader_that_is_cut_off_is_replaced_and_comes_back_as_a_follower() {
    on_a_site(|mut site, mut cluster, load| async move {
        let mut partitions = 0;
        for round in 0..2 * rounds() {
            let (leader, before) = cluster.leader_among(&[0, 1, 2]).await;
            // Every second time the learner stays with it: a majority of nodes is no majority of voters.
            let minority = [leader, 3];
            site.part(&minority[..2 - round as usize % 2]);
            partitions += 1;
            let (_, after) = cluster.leader_among(&others(leader)).await;
            assert!(after.term > before.term);
            load.more("without the leader that was cut off", 30, &mut cluster).await;
            steps_down(&cluster, leader).await;
            site.heal();
            load.more("after healing", 30, &mut cluster).await;
        }
        let told = load.finish().await;
        audit(&mut cluster, &told).await;
        println!(
            "faults injected: {partitions} leaders cut off; {} acknowledged transactions, refused {:?}",
            told.acknowledged.len(),
            told.refused
        );
        assert!(partitions > 0);
    });
}

#[test]
fn a_loss_in_one_direction_stops_nobody_for_good() {
    on_a_site(|mut site, mut cluster, load| async move {
        let mut losses = 0;
        for _ in 0..rounds() {
            // The leader is not heard: the others elect. The leader does not hear: it sees that and gives up.
            for heard in [false, true] {
                let (leader, before) = cluster.leader_among(&[0, 1, 2]).await;
                for other in (0..NODES).filter(|other| *other != leader) {
                    let (from, to) = if heard { (other, leader) } else { (leader, other) };
                    site.cut(from, to);
                    losses += 1;
                }
                let (_, after) = cluster.leader_among(&others(leader)).await;
                assert!(after.term > before.term);
                load.more(&format!("leader heard: {heard}"), 30, &mut cluster).await;
                site.heal();
                load.more("after healing", 30, &mut cluster).await;
            }
            // A follower that hears everybody and is heard by nobody, and the other way round: the rest goes on under
            // the leader that it has.
            for heard in [false, true] {
                let (leader, _) = cluster.leader_among(&[0, 1, 2]).await;
                let follower = others(leader)[0];
                for other in (0..NODES).filter(|other| *other != follower) {
                    let (from, to) = if heard { (other, follower) } else { (follower, other) };
                    site.cut(from, to);
                    losses += 1;
                }
                load.more(&format!("follower heard: {heard}"), 60, &mut cluster).await;
                site.heal();
                load.more("after healing", 30, &mut cluster).await;
            }
        }
        let told = load.finish().await;
        audit(&mut cluster, &told).await;
        println!(
            "faults injected: {losses} links cut in one direction; {} acknowledged transactions, refused {:?}",
            told.acknowledged.len(),
            told.refused
        );
        assert!(losses > 0);
    });
}

#[test]
fn a_client_whose_gateway_is_in_the_minority_goes_on_through_another_node() {
    // No command is refused because a busy machine has made it wait.
    on_a_site_with("[order]\nwait_ms = 60000", |mut site, mut cluster, load| async move {
        let mut partitions = 0;
        for _ in 0..rounds() {
            for with_learner in [false, true] {
                let (leader, _) = cluster.leader_among(&[0, 1, 2]).await;
                let gateway = others(leader)[0];
                // A node that was cut off a moment ago is not taken where others serve.
                let client = until("the gateway is one that serves", || async {
                    let client = cluster.client_from(&cluster.guest, gateway).await;
                    (*client.node() == *cluster.fleet.nodes[gateway].address).then_some(client)
                })
                .await;
                let minority = if with_learner { vec![gateway, 3] } else { vec![gateway] };
                let first = 10 * partitions;
                let transaction = |number: u64| {
                    let args = message(0, first + number, b"minority");
                    let call = Call { chaincode: "abac".into(), function: "set".into(), args, ttl: PATIENCE };
                    client.prepare(call).unwrap()
                };
                // One is under way when the network breaks, one begins while it is broken.
                let before = client.submit_nowait(&transaction(1));
                site.part(&minority);
                partitions += 1;
                before.await.expect("what was under way gets its verdict");
                // The gateway cannot answer. The client has gone to another node, or has asked one beside it.
                let after = client.submit(transaction(2)).await.expect("another node takes it");
                assert!(after.height > 0, "{after:?}");
                load.more("without the minority", 30, &mut cluster).await;
                site.heal();
                load.more("after healing", 30, &mut cluster).await;
            }
        }
        let told = load.finish().await;
        audit(&mut cluster, &told).await;
        println!(
            "faults injected: {partitions} minorities with a gateway; {} acknowledged transactions, refused {:?}",
            told.acknowledged.len(),
            told.refused
        );
        assert!(partitions > 0);
    });
}

#[test]
fn after_links_that_flap_everybody_agrees_and_serves() {
    on_a_site(|mut site, mut cluster, load| async move {
        let mut dice = Dice::roll("flapping");
        let mut changes = 0;
        for round in 0..20 * rounds() {
            let one = dice.below(NODES as u64) as usize;
            let other = (one + 1 + dice.below(NODES as u64 - 1) as usize) % NODES;
            match dice.below(3) {
                0 => site.cut(one, other),
                1 => {
                    site.cut(one, other);
                    site.cut(other, one);
                }
                _ => site.part(&[one]),
            }
            changes += 1;
            // Not waits for anything: the rhythm of the fault.
            tokio::time::sleep(Duration::from_millis(20 + dice.below(400))).await;
            if round % 3 != 0 {
                site.heal();
                changes += 1;
                tokio::time::sleep(Duration::from_millis(dice.below(300))).await;
            }
            cluster.check();
        }
        site.heal();
        load.more("after the last healing", 100, &mut cluster).await;
        let told = load.finish().await;
        audit(&mut cluster, &told).await;
        println!(
            "faults injected: {changes} changes of flapping links; {} acknowledged transactions, refused {:?}",
            told.acknowledged.len(),
            told.refused
        );
        assert!(changes > 0);
    });
}
