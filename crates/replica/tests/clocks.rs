//! Wrong clocks, on small clusters.

use crate::cluster::Cluster;
use ledger::block::Payload;
use ledger_base::rejection::Code;
use ledger_raft::{Input, Lane, TIME_AHEAD_MAX};
use ledger_storage::entry::EntryKind;

const SECOND: u64 = 1_000_000;
const YEAR: i64 = 365 * 24 * 3600 * 1_000_000;

/// How far the newest block is ahead of the right time, microseconds.
fn ahead(cluster: &Cluster) -> i64 {
    let blocks = cluster.chosen.iter().filter(|entry| entry.kind == EntryKind::Normal);
    let time = blocks.map(|entry| Payload::from_bytes(entry.data.clone()).unwrap().time).max().unwrap_or(0);
    time.cast_signed() - cluster.time().cast_signed()
}

/// Node 1 leads from now on.
fn lead(cluster: &mut Cluster) {
    let leader = cluster.elect();
    cluster.input(leader, Input::TransferLeadership { to: 1 });
    cluster.until("node 1 leads", 400, |cluster| cluster.leader() == Some(1));
}

/// Everybody executes a transaction that is submitted at a node.
fn order(cluster: &mut Cluster, id: u64, text: &str) {
    cluster.submit(id, Lane::Data, text);
    cluster.until("it is executed", 400, |cluster| cluster.has_executed(id, text));
}

#[test]
fn a_leader_whose_clock_is_a_year_ahead_orders_by_the_clocks_of_the_others() {
    for lost in [None, Some(3)] {
        let mut cluster = Cluster::new(1, &[1, 2, 3], &[]);
        lead(&mut cluster);
        cluster.ahead.insert(1, YEAR);
        if let Some(lost) = lost {
            cluster.crash(lost);
        }
        for nth in 0..20 {
            order(&mut cluster, 2, &format!("t{nth}"));
            assert!(ahead(&cluster) <= TIME_AHEAD_MAX.cast_signed(), "{}", ahead(&cluster));
            cluster.run(20);
        }
        assert_eq!(cluster.leader(), Some(1), "it does no harm");
    }
}

#[test]
fn a_leader_that_orders_a_year_ahead_all_the_same_commits_nothing_and_loses_its_place() {
    let mut cluster = Cluster::new(2, &[1, 2, 3], &[]);
    lead(&mut cluster);
    cluster.ahead.insert(1, YEAR);
    cluster.deceived = Some(1);
    cluster.run(20);
    cluster.submit(1, Lane::Data, "far ahead");
    cluster.until("another leads", 400, |cluster| cluster.leader().is_some_and(|leader| leader != 1));
    for nth in 0..20 {
        order(&mut cluster, 2, &format!("t{nth}"));
        assert!(ahead(&cluster) <= TIME_AHEAD_MAX.cast_signed(), "{}", ahead(&cluster));
        cluster.run(20);
        assert_ne!(cluster.leader(), Some(1), "nobody votes for it");
    }
    cluster.until("it follows", 400, Cluster::converged);
}

#[test]
fn where_the_only_other_voter_is_slow_it_decides_how_far_block_time_goes() {
    let mut cluster = Cluster::new(3, &[1, 2, 3], &[]);
    lead(&mut cluster);
    cluster.crash(3);
    cluster.ahead.insert(2, -100 * SECOND.cast_signed());
    for nth in 0..20 {
        order(&mut cluster, 1, &format!("t{nth}"));
        cluster.run(100);
    }
    assert_eq!(cluster.leader(), Some(1));
}

#[test]
fn a_voter_whose_clock_is_slow_follows_the_others() {
    let mut cluster = Cluster::new(4, &[1, 2, 3], &[]);
    lead(&mut cluster);
    cluster.ahead.insert(3, -1000 * SECOND.cast_signed());
    cluster.crash(3);
    for nth in 0..20 {
        order(&mut cluster, 1, &format!("t{nth}"));
        cluster.run(1000);
        if nth == 10 {
            cluster.start(3);
        }
    }
    cluster.until("it has what the others have", 400, Cluster::converged);
    assert_eq!(cluster.leader(), Some(1));
}

#[test]
fn where_most_clocks_were_ahead_for_a_while_block_time_goes_on_and_everybody_agrees() {
    let mut cluster = Cluster::new(5, &[1, 2, 3], &[]);
    lead(&mut cluster);
    for id in [1, 2] {
        cluster.ahead.insert(id, 3600 * SECOND.cast_signed());
    }
    cluster.run(20);
    order(&mut cluster, 1, "an hour ahead");
    assert!(ahead(&cluster) > 3500 * SECOND.cast_signed());
    cluster.ahead.clear();
    let mut before = ahead(&cluster);
    for nth in 0..20 {
        order(&mut cluster, 1 + nth % 3, &format!("t{nth}"));
        assert!(ahead(&cluster) <= before + SECOND.cast_signed() / 10, "it does not get further ahead");
        before = ahead(&cluster);
        cluster.crash(1 + nth % 3);
        cluster.elect();
        cluster.start(1 + nth % 3);
        cluster.run(200);
    }
    cluster.until("all have all", 400, Cluster::converged);
}

#[test]
fn the_only_voter_waits_for_a_clock_that_has_jumped_ahead_and_orders_nothing_by_it() {
    let mut cluster = Cluster::new(6, &[1], &[]);
    cluster.elect();
    order(&mut cluster, 1, "before");
    cluster.ahead.insert(1, YEAR);
    cluster.run(10);
    cluster.submit(1, Lane::Data, "a year ahead");
    cluster.run(10);
    assert_eq!(cluster.nodes[&1].dropped, [("a year ahead".to_owned(), Code::ClockJumped)]);
    cluster.ahead.clear();
    cluster.run(10);
    order(&mut cluster, 1, "right again");
    assert!(ahead(&cluster) <= 0);
    cluster.ahead.insert(1, SECOND.cast_signed() * 60);
    cluster.crash(1);
    cluster.start(1);
    cluster.elect();
    order(&mut cluster, 1, "a restart confirms it");
}

#[test]
fn the_only_voter_whose_clock_is_behind_block_time_at_the_start_waits_for_the_clock_or_for_an_operator() {
    for confirms in [false, true] {
        let mut cluster = Cluster::new(7, &[1], &[]);
        cluster.elect();
        order(&mut cluster, 1, "before");
        cluster.crash(1);
        cluster.ahead.insert(1, -3600 * SECOND.cast_signed());
        cluster.start(1);
        cluster.elect();
        cluster.submit(1, Lane::Data, "an hour behind");
        cluster.run(10);
        assert_eq!(cluster.nodes[&1].dropped, [("an hour behind".to_owned(), Code::ClockJumped)]);
        match confirms {
            true => cluster.confirm_clock(1),
            false => cluster.ahead.clear(),
        }
        cluster.run(10);
        order(&mut cluster, 1, "after");
    }
}
