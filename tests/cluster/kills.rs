//! `kill -9` at any moment on any node, under load.

use crate::audit::{Chain, audit};
use crate::cluster::{Cluster, NODES, VOTERS};
use crate::load::{Load, Told};
use crate::rounds;
use crate::support::network::now;
use crate::support::{Dice, until};
use std::time::Duration;

/// A leader's death: the moment, and the term that it led.
struct LeaderKill {
    at: u64,
    term: u64,
}

/// Kills a node at a random moment of its work.
async fn kill(cluster: &mut Cluster, node: usize, dice: &mut Dice) {
    // Not a wait for anything: the moment of the fault.
    tokio::time::sleep(Duration::from_micros(dice.below(30_000))).await;
    cluster.kill(node);
}

/// Time from each leader's death to the first acknowledgement of a block of a later term, in milliseconds, sorted.
fn outages(kills: &[LeaderKill], told: &Told, chain: &Chain) -> Vec<u64> {
    let next = |kill: &LeaderKill| {
        let after = told.acknowledged.iter().filter(|told| chain.term(told.committed.height) > kill.term);
        after.map(|told| told.at.saturating_sub(kill.at) / 1000).min()
    };
    let mut times: Vec<_> = kills.iter().filter_map(next).collect();
    times.sort_unstable();
    times
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn with_one_node_killed_at_a_time_the_others_go_on_and_nothing_acknowledged_is_lost() {
    let mut dice = Dice::roll("kills, one at a time");
    let mut cluster = Cluster::found();
    cluster.run("open").await;
    let load = Load::start(&cluster).await;
    load.more("before the first kill", 20, &mut cluster).await;
    let (mut kills, mut leaders) = (0, Vec::new());
    for round in 0..8 * rounds() {
        // Every second time the leader, else anybody.
        let (leader, status) = cluster.leader_among(&[0, 1, 2]).await;
        let victim = if round % 2 == 0 { leader } else { dice.below(NODES as u64) as usize };
        kill(&mut cluster, victim, &mut dice).await;
        kills += 1;
        if victim == leader {
            leaders.push(LeaderKill { at: now(), term: status.term });
        }
        // With a majority alive, work goes on without the victim. Sometimes it comes back before that.
        if round % 4 != 3 {
            load.more(&format!("round {round} without node {}", victim + 1), 30, &mut cluster).await;
        }
        cluster.start(victim);
        load.more(&format!("round {round}"), 1 + dice.below(60), &mut cluster).await;
    }
    let told = load.finish().await;
    let chain = audit(&mut cluster, &told).await;
    cluster.stop_and_verify();
    let outages = outages(&leaders, &told, &chain);
    println!(
        "faults injected: {kills} kills, {} leader kills; {} acknowledged transactions on {NODES} nodes, refused {:?}; \
         from leader kill to next commit: median {} ms of {outages:?}",
        leaders.len(),
        told.acknowledged.len(),
        told.refused,
        outages[outages.len() / 2],
    );
    assert!(kills > 0 && !leaders.is_empty() && outages.len() == leaders.len());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn with_two_voters_killed_at_a_time_the_quorum_is_lost_and_comes_back_and_nothing_acknowledged_is_lost() {
    let mut dice = Dice::roll("kills, two at a time");
    let mut cluster = Cluster::found();
    cluster.run("open").await;
    let load = Load::start(&cluster).await;
    load.more("before the first kill", 20, &mut cluster).await;
    let mut kills = 0;
    for round in 0..3 * rounds() {
        let spared = dice.below(VOTERS as u64) as usize;
        let mut victims: Vec<_> = (0..VOTERS).filter(|node| *node != spared).collect();
        if dice.below(2) == 0 {
            victims.reverse();
        }
        for victim in &victims {
            kill(&mut cluster, *victim, &mut dice).await;
            kills += 1;
        }
        // The one that is left stops leading, if it did: it has nobody to agree with.
        until(&format!("round {round}: node {} does not lead alone", spared + 1), || async {
            let status = cluster.status(spared).await?;
            (status.role != "leader").then_some(())
        })
        .await;
        for victim in victims {
            cluster.start(victim);
        }
        load.more(&format!("round {round}: the quorum is back"), 20 + dice.below(40), &mut cluster).await;
    }
    let told = load.finish().await;
    audit(&mut cluster, &told).await;
    println!(
        "faults injected: {kills} kills in pairs, {} quorums lost; {} acknowledged transactions, refused {:?}",
        kills / 2,
        told.acknowledged.len(),
        told.refused,
    );
    assert!(kills > 0);
}
