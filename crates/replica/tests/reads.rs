//! Linearizable reads: no answer is older than the question, whoever led meanwhile. `cluster` checks that of every answer.

use crate::cluster::{Cluster, Faults};
use ledger_raft::{Input, Lane, Role};

#[test]
fn a_leader_that_was_stopped_answers_no_read_after_another_took_over() {
    for seed in 0..20 {
        let mut cluster = Cluster::new(seed, &[1, 2, 3], &[4]);
        let old = cluster.elect();
        cluster.submit(old, Lane::Data, "before");
        cluster.run(5);
        cluster.pause(old);
        cluster.until("another leads", 200, |cluster| cluster.leader().is_some_and(|leader| leader != old));
        let new = cluster.leader().unwrap();
        cluster.submit(new, Lane::Data, "after");
        cluster.until("it is ordered", 20, |cluster| cluster.has_executed(new, "after"));
        let height = cluster.height(new);
        // It wakes up and is asked before it hears anything.
        assert_eq!(cluster.status(old).role.role, Role::Leader);
        cluster.resume(old);
        cluster.input(old, Input::ReadIndex { context: 1 });
        cluster.run(50);
        assert!(cluster.nodes[&old].reads.is_empty(), "nobody confirms it");
        for id in 1..=4 {
            cluster.input(id, Input::ReadIndex { context: 2 });
        }
        cluster.until("all are answered", 50, |cluster| {
            cluster
                .nodes
                .values()
                .all(|node| node.reads.iter().any(|(context, index)| *context == 2 && *index >= height))
        });
    }
}

#[test]
fn reads_are_never_older_than_the_question_while_messages_repeat_and_leaders_stop() {
    let mut answered = 0;
    for seed in 0..12 {
        let mut cluster = Cluster::new(1000 + seed, &[1, 2, 3], &[4]);
        cluster.faults = Faults { lose: 2, duplicate: 60, delay_max: 150, disk_max: 3 };
        cluster.elect();
        for round in 0..300u64 {
            let any = 1 + cluster.random.below(4);
            cluster.input(any, Input::ReadIndex { context: round });
            cluster.submit(any, Lane::Data, &format!("{round}"));
            if let Some(leader) = cluster.leader()
                && round % 40 == 10
            {
                cluster.pause(leader);
            }
            if round % 40 == 35 {
                for id in 1..=4 {
                    cluster.resume(id);
                }
            }
            cluster.run_units(12);
        }
        answered += cluster.nodes.values().map(|node| node.reads.len()).sum::<usize>();
    }
    assert!(answered > 200, "found {answered}");
}
