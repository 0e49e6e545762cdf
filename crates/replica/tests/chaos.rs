//! Seeded storms: loss, duplicates, reordering, partitions, crashes that lose and tear, processes that are stopped and go
//! on, logs that are cut off, changes of members. The cluster checks safety at every step (see `cluster`); afterwards
//! everything heals and must serve.
//!
//! In every other storm the members follow wishes as the ledger would record them, through the planner.
//!
//! `LEDGER_RAFT_SEED=n ./test replica::chaos` repeats one seed; `LEDGER_RAFT_SEEDS=n` runs that many.

use crate::cluster::{CALM, Cluster, Faults};
use ledger_raft::{Change, Desired, Input, Lane, Membership, MembershipChange, Role};
use std::collections::BTreeSet;
use testkit::Random;

const SEEDS: u64 = 60;
/// Seeds of `./test --long`.
const SEEDS_LONG: u64 = 600;

/// The events of the storms, over all seeds: a kind that never happened was not tested.
#[derive(Debug, Default)]
struct Coverage {
    crashes: u64,
    partitions: u64,
    elections: u64,
    changes: u64,
    blocks: u64,
    joint: u64,
    behind: u64,
    snapshots: u64,
    fetched: u64,
    reads: u64,
    wishes: u64,
}

/// Somebody votes; of the others each votes, follows or goes.
fn wish(random: &mut Random, all: &[u64]) -> Desired {
    let mut wish = Desired::default();
    for id in all {
        match random.below(3) {
            0 => wish.voters.insert(*id),
            1 => wish.learners.insert(*id),
            _ => false,
        };
    }
    let first = all[random.below(all.len() as u64) as usize];
    wish.learners.remove(&first);
    wish.voters.insert(first);
    wish
}

fn storm(seed: u64, coverage: &mut Coverage) -> (u64, usize) {
    let voters: &[u64] = if seed.is_multiple_of(3) { &[1, 2, 3, 4, 5] } else { &[1, 2, 3] };
    let learners: &[u64] = &[8, 9];
    let segment_bytes = if seed % 4 < 3 { 8 * 1024 } else { 256 * 1024 };
    let mut cluster = Cluster::with_segments(seed, voters, learners, segment_bytes);
    let planned = seed.is_multiple_of(2);
    let mut all: Vec<u64> = cluster.nodes.keys().copied().collect();
    cluster.faults = Faults {
        lose: cluster.random.below(15),
        duplicate: cluster.random.below(15),
        delay_max: 1 + cluster.random.below(40),
        disk_max: 1 + cluster.random.below(30),
    };
    let mut down: BTreeSet<u64> = BTreeSet::new();
    for round in 0..300u64 {
        let any = all[cluster.random.below(all.len() as u64) as usize];
        let lane = if cluster.random.percent(10) { Lane::Control } else { Lane::Data };
        cluster.submit(any, lane, &format!("{seed}-{round}"));
        if cluster.random.percent(4) && down.len() < 2 && down.insert(any) {
            cluster.crash(any);
            coverage.crashes += 1;
        }
        if planned && round == 100 {
            // Ids are never used twice: a node that comes again is another one.
            cluster.join(10);
            all.push(10);
        }
        if planned && cluster.random.percent(3) {
            let wish = wish(&mut cluster.random, &all);
            cluster.want(wish);
            coverage.wishes += 1;
        }
        if cluster.random.percent(10)
            && let Some(id) = down.pop_first()
        {
            cluster.start(id);
        }
        match cluster.random.below(40) {
            0 => {
                let other = all[cluster.random.below(all.len() as u64) as usize];
                cluster.cut.insert((any, other));
                coverage.partitions += 1;
            }
            1 => {
                cluster.cut.extend(all.iter().flat_map(|other| [(any, *other), (*other, any)]));
                coverage.partitions += 1;
            }
            2..=4 => cluster.cut.clear(),
            5 if !planned => {
                let Some(leader) = cluster.leader() else { continue };
                let change = match cluster.random.below(3) {
                    0 => vec![Change::AddVoter(8)],
                    1 => vec![Change::AddLearner(8), Change::AddVoter(9)],
                    _ => vec![Change::AddLearner(9), Change::AddVoter(any)],
                };
                cluster.input(leader, Input::ChangeMembership(MembershipChange::new(change)));
            }
            6 => {
                let Some(leader) = cluster.leader() else { continue };
                cluster.input(leader, Input::TransferLeadership { to: any });
            }
            7 => cluster.input(any, Input::ReadIndex { context: round }),
            8 => cluster.input(any, Input::Unreachable { peer: any }),
            9 => cluster.input(any, Input::Campaign),
            10..=15 => {
                let keep = cluster.random.below(5);
                cluster.prune(any, keep);
            }
            16 if !cluster.is_paused(any) => cluster.pause(any),
            17..=19 => all.iter().for_each(|id| cluster.resume(*id)),
            _ => {}
        }
        cluster.run_units(15);
        assert!(cluster.nodes.values().all(|node| node.failed.is_none()));
        coverage.joint += u64::from(cluster.nodes.values().any(|node| node.members.is_joint()));
    }
    // Everything heals.
    cluster.cut.clear();
    cluster.faults = CALM;
    all.iter().for_each(|id| cluster.resume(*id));
    for id in down {
        cluster.start(id);
    }
    let leader = cluster.elect();
    cluster.run(20);
    cluster.check_log_matching();
    // The leadership may still move once; a client asks again.
    for _ in 0..20 {
        let leader = cluster.leader().unwrap_or(leader);
        cluster.submit(leader, Lane::Data, "healed");
        cluster.run(20);
    }
    if let Some(wish) = cluster.desired.clone() {
        cluster.until("the members become those desired", 3000, |cluster| {
            let members = cluster.members();
            members == Membership::new(wish.voters.clone(), wish.learners.clone())
        });
    }
    cluster.until("the healed cluster serves everywhere", 300, |cluster| {
        cluster.converged() && cluster.members().nodes().iter().all(|id| cluster.has_executed(*id, "healed"))
    });
    cluster.check_log_matching();
    let leading = all.iter().filter(|id| cluster.status(**id).role.role == Role::Leader).count();
    assert_eq!(leading, 1);
    assert!(!cluster.members().is_joint(), "a change of members is complete in the end");
    coverage.elections += cluster.leaders.len() as u64;
    coverage.behind += cluster.behind.told;
    coverage.snapshots += cluster.behind.snapshots;
    coverage.fetched += cluster.behind.fetched;
    coverage.reads += cluster.nodes.values().map(|node| node.reads.len() as u64).sum::<u64>();
    coverage.blocks += cluster.chosen.len() as u64;
    coverage.changes +=
        cluster.chosen.iter().filter(|entry| entry.kind != ledger_storage::entry::EntryKind::Normal).count() as u64;
    (cluster.trace, cluster.chosen.len())
}

#[test]
fn no_storm_breaks_a_promise() {
    let mut coverage = Coverage::default();
    let seeds: Vec<u64> = match std::env::var("LEDGER_RAFT_SEED") {
        Ok(seed) => vec![seed.parse().unwrap()],
        Err(_) => {
            let usual = if std::env::var_os("LEDGERD_TEST_LONG").is_some() { SEEDS_LONG } else { SEEDS };
            let count = std::env::var("LEDGER_RAFT_SEEDS").map_or(usual, |count| count.parse().unwrap());
            (0..count).collect()
        }
    };
    for seed in &seeds {
        eprintln!("seed {seed}: repeat with LEDGER_RAFT_SEED={seed}");
        storm(*seed, &mut coverage);
    }
    eprintln!("{coverage:?}");
    let Coverage { crashes, partitions, elections, changes, blocks, joint, .. } = coverage;
    if seeds.len() > 1 {
        assert!(coverage.snapshots > 10 && coverage.fetched > 10 && coverage.reads > 100 && coverage.wishes > 100);
        assert!(crashes > 300 && partitions > 300 && elections > 200 && changes > 50 && joint > 20 && blocks > 2000);
    }
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let mut coverage = Coverage::default();
    assert_eq!(storm(4, &mut coverage), storm(4, &mut coverage));
    assert_ne!(storm(4, &mut coverage), storm(5, &mut coverage));
}
