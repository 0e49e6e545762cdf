//! Logs that begin above 1, nodes that are too far behind for them, and nodes that have lost their disk.

use crate::cluster::{CALM, Cluster, Faults};
use ledger_base::rejection::Code;
use ledger_raft::{Input, Lane, LogBegin, PeerMessage, Role};

/// Orders this many blocks through whoever leads.
fn order(cluster: &mut Cluster, blocks: u64) {
    let leader = cluster.elect();
    for nth in 0..blocks {
        cluster.submit(leader, Lane::Data, &format!("b{}-{nth}", cluster.now));
        cluster.run_units(3);
    }
}

/// Three voters (and learner 4), of which `away` is down while the others order blocks and drop them.
fn with_pruned_logs(seed: u64, away: u64) -> Cluster {
    let mut cluster = Cluster::with_segments(seed, &[1, 2, 3], &[4], 16 * 1024);
    order(&mut cluster, 20);
    cluster.crash(away);
    order(&mut cluster, 200);
    for id in (1..=4).filter(|id| *id != away) {
        cluster.prune(id, 5);
        assert!(cluster.status(id).first > 100);
    }
    cluster
}

#[test]
fn a_node_that_needs_dropped_blocks_is_told_and_catches_up_elsewhere() {
    for seed in 0..10 {
        for away in [3, 4] {
            let mut cluster = with_pruned_logs(100 + seed, away);
            cluster.start(away);
            cluster.until("the node has all", 200, Cluster::converged);
            assert_eq!(cluster.behind.told, 1, "once: then the leader knows what it holds");
            order(&mut cluster, 20);
            cluster.until("replication goes on", 20, Cluster::converged);
            cluster.check_log_matching();
        }
    }
}

#[test]
fn a_leader_whose_log_begins_above_1_is_elected_and_orders_after_a_restart() {
    let mut cluster = with_pruned_logs(200, 3);
    for id in [1, 2, 4] {
        cluster.crash(id);
    }
    for id in [1, 2, 4, 3] {
        cluster.start(id);
    }
    order(&mut cluster, 20);
    cluster.until("all have all", 200, Cluster::converged);
    assert!(cluster.behind.told >= 1);
}

#[test]
fn a_node_that_went_on_after_a_snapshot_votes_leads_and_restarts() {
    for seed in 0..6 {
        let mut cluster = with_pruned_logs(300 + seed, 3);
        cluster.start(3);
        cluster.until("node 3 has all", 200, Cluster::converged);
        cluster.crash(3);
        cluster.start(3);
        order(&mut cluster, 5);
        cluster.until("all have all", 50, Cluster::converged);
        let leader = cluster.elect();
        cluster.input(leader, Input::TransferLeadership { to: 3 });
        cluster.until("node 3 leads", 50, |cluster| cluster.leader() == Some(3));
        order(&mut cluster, 5);
        cluster.until("all have all", 50, Cluster::converged);
    }
}

#[test]
fn a_new_learner_behind_a_log_that_was_cut_off_comes_in() {
    use ledger_raft::{Change, MembershipChange};
    let mut cluster = with_pruned_logs(400, 3);
    cluster.start(3);
    cluster.join(5);
    let leader = cluster.elect();
    cluster.input(leader, Input::ChangeMembership(MembershipChange::new([Change::AddLearner(5)])));
    cluster.until("it has all", 300, |cluster| {
        cluster.members().contains(5) && cluster.height(5) == cluster.chosen.len() as u64
    });
    order(&mut cluster, 10);
    cluster.until("replication goes on", 20, Cluster::converged);
}

#[test]
fn a_learner_that_lost_its_disk_is_served_again_by_the_same_leader() {
    for seed in 0..5 {
        let mut cluster = Cluster::new(500 + seed, &[1, 2, 3], &[4]);
        order(&mut cluster, 50);
        cluster.until("the learner has all", 20, Cluster::converged);
        let leader = cluster.leader();
        cluster.lose_disk(4);
        cluster.start(4);
        cluster.until("the learner has all again", 200, Cluster::converged);
        order(&mut cluster, 20);
        cluster.until("replication goes on", 20, Cluster::converged);
        assert_eq!(cluster.leader(), leader);
        assert!(cluster.behind.told > 0);
    }
}

#[test]
fn a_voter_that_lost_its_disk_stops_and_says_why() {
    let mut cluster = Cluster::new(600, &[1, 2, 3], &[]);
    order(&mut cluster, 50);
    cluster.until("all have all", 20, Cluster::converged);
    let leader = cluster.leader().unwrap();
    let victim = 1 + leader % 3;
    cluster.lose_disk(victim);
    cluster.start(victim);
    cluster.until("it stops", 100, |cluster| cluster.nodes[&victim].failed.is_some());
    let reason = cluster.nodes[&victim].failed.clone().unwrap();
    assert_eq!(reason.code, Code::DiskFailed);
    assert!(reason.to_string().contains("lost blocks"), "{reason}");
    order(&mut cluster, 5);
}

#[test]
fn only_the_leader_is_believed_and_only_by_a_node_that_is_behind() {
    let mut cluster = Cluster::new(700, &[1, 2, 3], &[4]);
    let leader = cluster.elect();
    order(&mut cluster, 10);
    let other = 1 + leader % 3;
    let behind = |first_index| PeerMessage::Behind(LogBegin { first_index });
    cluster.input(4, Input::Message { from: other, message: behind(1000) });
    cluster.input(4, Input::Message { from: leader, message: behind(5) });
    cluster.input(4, Input::Message { from: leader, message: behind(0) });
    cluster.input(leader, Input::Message { from: other, message: behind(u64::MAX) });
    assert_eq!(cluster.behind.told, 0);
    cluster.input(4, Input::Message { from: leader, message: behind(1000) });
    assert_eq!(cluster.behind.told, 1);
}

#[test]
fn logs_may_be_cut_off_under_load_while_messages_are_lost() {
    let mut cluster = Cluster::with_segments(800, &[1, 2, 3], &[4], 16 * 1024);
    cluster.faults = Faults { lose: 10, duplicate: 10, delay_max: 30, disk_max: 10 };
    for round in 0..400u64 {
        cluster.submit(1 + round % 4, Lane::Data, &format!("t{round}"));
        if round % 10 == 0 {
            cluster.prune(1 + round / 10 % 4, 0);
        }
        cluster.run_units(10);
    }
    cluster.faults = CALM;
    order(&mut cluster, 5);
    cluster.until("all have all", 100, Cluster::converged);
    assert!(cluster.status(1).first > 100);
    assert_eq!((1..=4).filter(|id| cluster.status(*id).role.role == Role::Leader).count(), 1);
}
