//! A leader that withholds control calls is deposed, and honest ones are not, however slow they or the links are.

use crate::cluster::{Cluster, Faults};
use ledger_raft::Lane;

/// Node 1 leads.
fn led_by_the_first(seed: u64, voters: &[u64]) -> Cluster {
    let mut cluster = Cluster::new(seed, voters, &[]);
    cluster.elect();
    for _ in 0..20 {
        if cluster.leader() == Some(1) {
            break;
        }
        let leader = cluster.leader().unwrap();
        cluster.input(leader, ledger_raft::Input::TransferLeadership { to: 1 });
        cluster.run(100);
    }
    assert_eq!(cluster.leader(), Some(1));
    cluster.run(50);
    cluster
}

/// Runs so many ticks, in which data comes through a node ten times a second.
fn run_with_data(cluster: &mut Cluster, through: u64, ticks: u64) {
    for _ in 0..ticks / 10 {
        let text = format!("data at {}", cluster.now);
        cluster.submit(through, Lane::Data, &text);
        cluster.run(10);
    }
}

#[test]
fn a_leader_that_withholds_control_calls_is_deposed_and_the_next_one_orders_them() {
    for (seed, voters) in [(1, &[1, 2, 3][..]), (2, &[1, 2, 3, 4, 5]), (3, &[1, 2, 3, 4, 5, 6, 7])] {
        let mut cluster = led_by_the_first(seed, voters);
        let term = cluster.status(1).role.term;
        cluster.withholds = Some(1);
        cluster.submit(2, Lane::Control, "stop");
        run_with_data(&mut cluster, 3, 150);
        assert!(!cluster.has_executed(2, "stop") && cluster.leader() == Some(1), "it may take its time");
        run_with_data(&mut cluster, 3, 250);
        assert!(cluster.complaints > 1, "{}", cluster.complaints);
        assert!(cluster.leader().is_some_and(|leader| leader != 1));
        assert!(cluster.status(2).role.term > term && cluster.has_executed(2, "stop"));
        // It is not elected for a while.
        cluster.run(500);
        assert_ne!(cluster.leader(), Some(1));
    }
}

#[test]
fn a_leader_that_orders_nothing_at_all_is_complained_about_after_five_seconds() {
    let mut cluster = led_by_the_first(4, &[1, 2, 3]);
    cluster.withholds = Some(1);
    cluster.submit(2, Lane::Control, "stop");
    cluster.run(450);
    assert_eq!((cluster.leader(), cluster.complaints), (Some(1), 0), "it may be slow");
    cluster.run(450);
    assert!(cluster.leader() != Some(1) && cluster.complaints > 0);
    assert!(cluster.has_executed(2, "stop"));
}

#[test]
fn a_follower_whose_messages_are_lost_on_their_way_to_the_leader_has_its_call_ordered_through_the_others() {
    let mut cluster = led_by_the_first(5, &[1, 2, 3, 4, 5]);
    cluster.cut.extend([(2, 1), (3, 1)]);
    cluster.submit(2, Lane::Control, "stop");
    run_with_data(&mut cluster, 4, 600);
    assert!(cluster.has_executed(1, "stop"));
    assert_eq!((cluster.leader(), cluster.complaints), (Some(1), 0));
}

#[test]
fn overload_and_slow_disks_and_links_make_nobody_complain() {
    for seed in 0..3 {
        let mut cluster = led_by_the_first(seed, &[1, 2, 3, 4, 5]);
        let (delay_max, disk_max) = [(1, 100), (30, 1), (20, 60)][seed as usize % 3];
        cluster.faults = Faults { delay_max, disk_max, ..cluster.faults };
        for round in 0..60 {
            for node in 1..=5 {
                cluster.submit(node, Lane::Control, &format!("{round} control at {node}"));
                for nth in 0..50 {
                    cluster.submit(node, Lane::Data, &format!("{round} data {nth} at {node}"));
                }
            }
            cluster.run(10);
        }
        cluster.faults = crate::cluster::CALM;
        cluster.run(300);
        assert_eq!(cluster.complaints, 0, "seed {seed}");
        assert!(
            (0..60).all(|round| (1..=5).all(|node| cluster.has_executed(1, &format!("{round} control at {node}"))))
        );
    }
}
