//! The promises of ordering, on small clusters without random faults.

use crate::cluster::{ALARM, Cluster, UNIT, transactions};
use ledger::block::Payload;
use ledger_base::rejection::Code;
use ledger_raft::{Change, Input, Lane, MembershipChange, PeerMessage, Role, Transactions};
use ledger_storage::entry::EntryKind;

/// Most bytes of a leader's data that wait for their execution.
const AHEAD_BYTES: usize = 64 * 1024;
/// The cost of executing a transaction, in bytes.
const TRANSACTION_COST: usize = 256;

fn change(changes: impl IntoIterator<Item = Change>) -> Input {
    Input::ChangeMembership(MembershipChange::new(changes))
}

#[test]
fn one_voter_leads_at_once_and_orders() {
    let mut cluster = Cluster::new(1, &[1], &[]);
    cluster.run(1);
    assert_eq!(cluster.leader(), Some(1), "without waiting for an election timeout");
    for nth in 0..50 {
        cluster.submit(1, Lane::Data, &format!("t{nth}"));
    }
    cluster.run(2);
    let wanted: Vec<_> = (0..50).map(|nth| format!("t{nth}")).collect();
    assert_eq!(cluster.executed_by(1), wanted);
}

#[test]
fn what_waits_while_the_disk_works_becomes_one_block() {
    let mut cluster = Cluster::new(1, &[1], &[]);
    cluster.elect();
    let before = cluster.height(1) as usize;
    for nth in 0..40 {
        cluster.submit(1, Lane::Data, &format!("t{nth}"));
    }
    cluster.run(1);
    let sizes: Vec<_> = cluster.chosen[before..].iter().map(|block| transactions([block]).len()).collect();
    assert_eq!(sizes, [1, 1, 38], "two writes are under way, the rest waits and goes together");
}

#[test]
fn a_learner_hears_of_a_commit_within_one_message_and_never_votes() {
    let mut cluster = Cluster::new(2, &[1], &[2]);
    cluster.elect();
    cluster.until("the learner has caught up", 20, Cluster::converged);
    cluster.submit(1, Lane::Data, "now");
    // Entry to the learner, both disks, of which the learner's waits a little, commit to the learner: less than a tick.
    cluster.run_units(8);
    assert!(cluster.has_executed(2, "now"));
    cluster.crash(1);
    cluster.run(200);
    assert_eq!(cluster.status(2).role.role, Role::Follower);
    cluster.submit(2, Lane::Data, "late");
    assert_eq!(cluster.nodes[&2].dropped, [("late".to_owned(), Code::NoLeader)]);
}

#[test]
fn three_voters_execute_the_same_in_the_same_order_whoever_takes_it_in() {
    let mut cluster = Cluster::new(3, &[1, 2, 3], &[4]);
    cluster.elect();
    for nth in 0..200 {
        cluster.submit(1 + nth % 4, Lane::Data, &format!("t{nth}"));
        cluster.run_units(1);
    }
    cluster.until("all have all", 50, |cluster| cluster.converged() && transactions(&cluster.chosen).len() == 200);
    for id in 2..=4 {
        assert_eq!(cluster.executed_by(id), cluster.executed_by(1));
    }
    cluster.check_log_matching();
}

#[test]
fn the_leader_dies_and_nothing_acknowledged_is_lost() {
    let mut cluster = Cluster::new(4, &[1, 2, 3], &[]);
    let first = cluster.elect();
    for nth in 0..20 {
        cluster.submit(first, Lane::Data, &format!("t{nth}"));
        cluster.run_units(2);
    }
    let acknowledged = cluster.executed_by(first);
    assert!(acknowledged.len() > 10);
    cluster.crash(first);
    cluster.until("another leads", 100, |cluster| cluster.leader().is_some());
    let second = cluster.leader().unwrap();
    assert_ne!(first, second);
    cluster.submit(second, Lane::Data, "after");
    cluster.run(2);
    let executed = cluster.executed_by(second);
    assert_eq!(executed[..acknowledged.len()], acknowledged);
    assert!(executed.contains(&"after".to_owned()));
    cluster.start(first);
    cluster.until("the old leader follows", 100, Cluster::converged);
}

#[test]
fn a_crash_loses_what_was_not_flushed_and_nothing_else() {
    let mut cluster = Cluster::new(5, &[1], &[]);
    cluster.elect();
    cluster.submit(1, Lane::Data, "kept");
    cluster.run(1);
    cluster.submit(1, Lane::Data, "lost");
    // Proposed and staged, but the flush has not happened.
    assert_eq!(cluster.status(1).last, 3);
    cluster.crash(1);
    cluster.start(1);
    cluster.elect();
    cluster.submit(1, Lane::Data, "next");
    cluster.run(1);
    assert_eq!(cluster.executed_by(1), ["kept", "next"]);
}

#[test]
fn a_learner_that_was_away_catches_up() {
    let mut cluster = Cluster::new(6, &[1, 2, 3], &[4]);
    let leader = cluster.elect();
    cluster.crash(4);
    for nth in 0..3000 {
        cluster.submit(leader, Lane::Data, &format!("t{nth}"));
        if nth % 2 == 0 {
            cluster.run_units(1);
        }
    }
    cluster.run(5);
    assert!(cluster.chosen.len() > 1000, "more blocks than one message holds: {}", cluster.chosen.len());
    cluster.start(4);
    cluster.until("the learner has all", 100, Cluster::converged);
    assert_eq!(cluster.executed_by(4).len(), 3000);
}

#[test]
fn little_data_is_ahead_of_control_however_much_waits() {
    let mut cluster = Cluster::new(21, &[1], &[]);
    cluster.elect();
    let cost = cluster.awaited(1, Lane::Data, "data0").unwrap().len() + TRANSACTION_COST;
    for nth in 0..2000 {
        cluster.submit(1, Lane::Data, &format!("data{nth}"));
    }
    cluster.run_units(5);
    let before = cluster.executed_by(1).len();
    cluster.submit(1, Lane::Control, "stop");
    cluster.until("the stop is executed", 100, |cluster| cluster.has_executed(1, "stop"));
    let at = cluster.executed_by(1).iter().position(|transaction| transaction == "stop").unwrap();
    // As many as may be ahead; as many may be on their way to the disk.
    let ahead_max = 2 * (AHEAD_BYTES / cost + 1);
    assert!(at - before <= ahead_max && ahead_max < 500, "{} of {ahead_max} were ahead", at - before);
    cluster.until("the rest follows", 2000, |cluster| cluster.executed_by(1).len() == 2001);
}

#[test]
fn data_that_waits_too_long_is_refused_and_control_is_not() {
    let mut cluster = Cluster::with_timing(22, (&[1], &[]), 256 * 1024, 50 * UNIT);
    cluster.faults.disk_max = 30;
    cluster.elect();
    for nth in 0..1000 {
        cluster.submit(1, Lane::Data, &format!("data{nth}"));
        cluster.submit(1, Lane::Control, &format!("stop{nth}"));
    }
    cluster.until("everything has its answer", 2000, |cluster| {
        cluster.executed_by(1).len() + cluster.nodes[&1].dropped.len() == 2000
    });
    let dropped = &cluster.nodes[&1].dropped;
    assert!(dropped.len() > 500 && dropped.iter().all(|(_, code)| *code == Code::Overloaded), "{}", dropped.len());
    let executed = cluster.executed_by(1);
    assert_eq!(executed.iter().filter(|transaction| transaction.starts_with("stop")).count(), 1000);
    assert!(executed.contains(&"data999".to_owned()), "the oldest go, the newest stay");
}

#[test]
fn control_overtakes_data() {
    let mut cluster = Cluster::new(7, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    for nth in 0..100 {
        cluster.submit(leader, Lane::Data, &format!("data{nth}"));
    }
    cluster.submit(leader, Lane::Control, "stop");
    cluster.run(2);
    let executed = cluster.executed_by(leader);
    let at = executed.iter().position(|transaction| transaction == "stop").unwrap();
    assert_eq!(at, 2, "behind the two blocks that were under way, before all that waited");
}

#[test]
fn a_full_queue_refuses_here_and_tells_the_node_that_forwarded() {
    let mut cluster = Cluster::new(8, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    let other = if leader == 1 { 2 } else { 1 };
    // The majority is gone: the leader can order nothing, its queue fills.
    for id in 1..=3 {
        cluster.cut.extend([(leader, id)]);
    }
    cluster.run_units(5);
    let max = ledger_raft::DATA_QUEUE_TRANSACTIONS_MAX;
    for nth in 0..max + 1000 {
        cluster.submit(leader, Lane::Data, &format!("t{nth}"));
    }
    let dropped = &cluster.nodes[&leader].dropped;
    assert!(!dropped.is_empty() && dropped.iter().all(|(_, code)| *code == Code::Overloaded));
    assert!(cluster.status(leader).data.transactions <= max);
    cluster.submit(leader, Lane::Control, "stop");
    assert!(!cluster.nodes[&leader].dropped.iter().any(|(text, _)| text == "stop"), "the other lane is free");

    cluster.cut.clear();
    let forwarded = cluster.awaited(other, Lane::Data, "forwarded").unwrap();
    let sent = Transactions { control: vec![], data: vec![forwarded], code: 0 };
    cluster.input(leader, Input::Message { from: other, message: PeerMessage::Forward(sent) });
    cluster.run_units(3);
    assert_eq!(cluster.nodes[&other].dropped, [("forwarded".to_owned(), Code::Overloaded)]);
}

#[test]
fn a_node_that_is_not_the_leader_gives_back_what_is_forwarded_to_it() {
    let mut cluster = Cluster::new(9, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    let others: Vec<_> = (1..=3).filter(|id| *id != leader).collect();
    cluster.input(leader, Input::TransferLeadership { to: others[0] });
    cluster.run(30);
    assert_eq!(cluster.leader(), Some(others[0]));
    let control = vec![cluster.awaited(others[1], Lane::Control, "c").unwrap()];
    let data = vec![cluster.awaited(others[1], Lane::Data, "d").unwrap()];
    let sent = Transactions { control, data, code: 0 };
    cluster.input(leader, Input::Message { from: others[1], message: PeerMessage::Forward(sent) });
    cluster.run(1);
    assert_eq!(cluster.nodes[&others[1]].dropped, [("c".to_owned(), Code::NoLeader), ("d".to_owned(), Code::NoLeader)]);
}

#[test]
fn a_leader_that_is_cut_off_hands_what_waits_to_the_next_or_gives_it_back() {
    let mut cluster = Cluster::new(10, &[1, 2, 3], &[]);
    let old = cluster.elect();
    for id in 1..=3 {
        cluster.cut.extend([(old, id), (id, old)]);
    }
    for nth in 0..600 {
        cluster.submit(old, Lane::Data, &format!("t{nth}"));
    }
    assert!(cluster.status(old).data.transactions > 0);
    cluster.until("the old leader knows", 100, |cluster| cluster.status(old).role.role != Role::Leader);
    cluster.cut.clear();
    cluster.until("all wait for nothing", 200, |cluster| {
        cluster.leader().is_some() && cluster.status(old).data.transactions == 0
    });
    cluster.run(50);
    // Also what was proposed already, and is lost with the old leadership: its clients still wait.
    let executed = cluster.executed_by(old).len();
    assert_eq!(executed + cluster.nodes[&old].dropped.len(), 600);
}

#[test]
fn a_member_is_added_and_promoted_while_transactions_flow_and_restart_knows_it() {
    let mut cluster = Cluster::new(11, &[1], &[]);
    cluster.elect();
    let mut nth = 0;
    let mut flow = |cluster: &mut Cluster, steps: u64| {
        for _ in 0..steps {
            cluster.submit(1, Lane::Data, &format!("t{nth}"));
            nth += 1;
            cluster.run_units(1);
        }
    };
    flow(&mut cluster, 50);
    cluster.join(2);
    cluster.join(3);
    cluster.input(1, change([Change::AddLearner(2), Change::AddLearner(3)]));
    flow(&mut cluster, 100);
    assert!(cluster.converged() || (cluster.height(2) as usize) > 50);
    cluster.input(1, change([Change::AddVoter(2), Change::AddVoter(3)]));
    flow(&mut cluster, 100);
    for id in 1..=3 {
        let members = &cluster.nodes[&id].members;
        assert_eq!(members.voters, [1, 2, 3].into());
        assert!(!members.is_joint() && members.learners.is_empty());
    }
    assert!(cluster.nodes[&1].refused.is_empty(), "{:?}", cluster.nodes[&1].refused);
    // `start` checks that the members after a restart are those of the state.
    for id in 1..=3 {
        cluster.crash(id);
    }
    for id in 1..=3 {
        cluster.start(id);
    }
    let leader = cluster.elect();
    cluster.crash(leader);
    let next = cluster.elect();
    assert_ne!(leader, next, "any of the three may lead now");
    cluster.submit(next, Lane::Data, "after");
    cluster.until("it is ordered", 50, |cluster| cluster.has_executed(next, "after"));
}

#[test]
fn members_change_only_through_a_ready_leader_one_change_at_a_time() {
    let mut cluster = Cluster::new(12, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    let other = 1 + leader % 3;
    let refused = |cluster: &Cluster, id: u64| cluster.nodes[&id].refused.last().map(|(_, reason)| reason.code);
    cluster.input(other, change([Change::AddLearner(9)]));
    assert_eq!(refused(&cluster, other), Some(Code::NoLeader));
    cluster.input(leader, change([Change::Remove(leader)]));
    assert_eq!(refused(&cluster, leader), Some(Code::BadArgument));
    cluster.input(leader, change([]));
    assert_eq!(refused(&cluster, leader), Some(Code::BadArgument));
    cluster.input(leader, change([Change::AddLearner(9)]));
    cluster.input(leader, change([Change::AddLearner(8)]));
    assert_eq!(refused(&cluster, leader), Some(Code::Overloaded));
    cluster.run(5);
    assert_eq!(cluster.nodes[&other].members.learners, [9].into());
    cluster.input(leader, change([Change::Remove(other)]));
    cluster.run(5);
    assert!(!cluster.nodes[&leader].members.contains(other));
}

/// A change that was proposed by one leader may be committed under the node that it removes.
#[test]
fn a_leader_that_a_change_removes_steps_down() {
    let mut cluster = Cluster::new(13, &[1, 2, 3], &[]);
    let first = cluster.elect();
    let victim = 1 + first % 3;
    let third = 6 - first - victim;
    cluster.cut.insert((first, third));
    cluster.cut.insert((victim, first));
    cluster.input(first, change([Change::Remove(victim)]));
    cluster.run_units(5);
    assert!(cluster.nodes[&victim].members.contains(victim), "the change is not committed");
    let term = cluster.status(first).role.term;
    cluster.crash(first);
    cluster.cut.clear();
    cluster.until("the victim has committed its own removal", 300, |cluster| {
        !cluster.nodes[&victim].members.contains(victim)
    });
    assert!(cluster.leaders.iter().any(|(later, leader)| *later > term && *leader == victim), "as the leader");
    assert_eq!(cluster.status(victim).role.role, Role::Follower);
    cluster.start(first);
    let leader = cluster.elect();
    assert_ne!(leader, victim);
    cluster.submit(leader, Lane::Data, "after");
    cluster.run(5);
    assert!(cluster.has_executed(leader, "after"));
}

#[test]
fn a_learner_never_leads_even_if_told_to_stand_for_election() {
    let mut cluster = Cluster::new(18, &[1, 2, 3], &[4]);
    cluster.input(4, Input::Campaign);
    cluster.run(10);
    assert!(cluster.leaders.is_empty());
    assert_ne!(cluster.elect(), 4);
}

#[test]
fn leadership_is_handed_over_on_demand() {
    let mut cluster = Cluster::new(14, &[1, 2, 3], &[4]);
    let leader = cluster.elect();
    let to = 1 + leader % 3;
    cluster.input(leader, Input::TransferLeadership { to: 4 });
    assert_eq!(cluster.nodes[&leader].refused.len(), 1, "a learner cannot lead");
    cluster.input(leader, Input::TransferLeadership { to });
    cluster.submit(leader, Lane::Data, "meanwhile");
    cluster.until("the other leads", 10, |cluster| cluster.leader() == Some(to));
    cluster.run(5);
    assert!(cluster.has_executed(leader, "meanwhile"), "what waited went to the new leader");
}

#[test]
fn a_read_waits_for_a_majority_to_confirm_the_leader() {
    let mut cluster = Cluster::new(15, &[1, 2, 3], &[4]);
    let leader = cluster.elect();
    cluster.submit(leader, Lane::Data, "seen");
    cluster.until("it is ordered", 10, |cluster| cluster.has_executed(leader, "seen"));
    let index = cluster.height(leader);
    for id in 1..=4 {
        cluster.input(id, Input::ReadIndex { context: id });
        cluster.run(1);
        assert_eq!(cluster.nodes[&id].reads, [(id, index)]);
    }
    // Cut off, it may be deposed already: no answer.
    for id in 1..=4 {
        cluster.cut.extend([(leader, id), (id, leader)]);
    }
    cluster.input(leader, Input::ReadIndex { context: 77 });
    cluster.run(100);
    assert_eq!(cluster.nodes[&leader].reads.len(), 1);
}

#[test]
fn a_deadline_makes_one_empty_block_and_an_idle_network_none() {
    let mut cluster = Cluster::new(16, &[1], &[2]);
    cluster.elect();
    cluster.run(100);
    assert_eq!(cluster.chosen.len(), 1, "only the entry that opened the term");
    cluster.submit(1, Lane::Data, "alarm");
    cluster.run_units(ALARM / UNIT - 10);
    assert_eq!(cluster.chosen.len(), 2, "it is not due yet");
    cluster.run(100);
    assert_eq!(cluster.chosen.len(), 3, "one, made by the leader");
    assert!(transactions(&cluster.chosen[2..]).is_empty() && cluster.converged());
}

#[test]
fn block_time_never_goes_back_across_leaders_and_restarts() {
    let mut cluster = Cluster::new(17, &[1], &[]);
    cluster.elect();
    cluster.submit(1, Lane::Data, "a");
    cluster.run(1);
    cluster.crash(1);
    cluster.ahead.insert(1, -500 * 1_000_000);
    cluster.start(1);
    cluster.confirm_clock(1);
    cluster.elect();
    cluster.submit(1, Lane::Data, "b");
    cluster.run(1);
    let times: Vec<_> = cluster
        .chosen
        .iter()
        .filter(|entry| entry.kind == EntryKind::Normal)
        .map(|entry| Payload::from_bytes(entry.data.clone()).unwrap().time)
        .filter(|time| *time > 0)
        .collect();
    assert_eq!(times.len(), 2);
    assert!(times[0] <= times[1], "{times:?}");
}
