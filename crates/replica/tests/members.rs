//! The life of members: in as a learner, a voter, the leader, demoted, out, and in again under another id.

use crate::cluster::Cluster;
use ledger_base::rejection::Code;
use ledger_raft::{Change, Desired, Input, Lane, Membership, MembershipChange, Role};

fn wish(voters: &[u64], learners: &[u64]) -> Desired {
    let [voters, learners] = [voters, learners].map(|nodes| nodes.iter().copied().collect());
    Desired { voters, learners, ..Desired::default() }
}

/// Sets the wish and lets traffic run until the members are those; answers with the number of blocks that took.
fn follow(cluster: &mut Cluster, voters: &[u64], learners: &[u64]) {
    cluster.want(wish(voters, learners));
    let wanted = Membership::new(voters.iter().copied(), learners.iter().copied());
    for nth in 0..3000u64 {
        if cluster.members() == wanted && cluster.leader().is_some_and(|leader| wanted.is_voter(leader)) {
            return;
        }
        if let Some(leader) = cluster.leader() {
            cluster.submit(leader, Lane::Data, &format!("{voters:?}-{learners:?}-{nth}"));
        }
        cluster.run_units(5);
    }
    panic!("wanted {wanted:?}, found {:?}", cluster.members());
}

#[test]
fn a_node_joins_leads_is_demoted_goes_and_comes_again_under_another_id_while_traffic_runs() {
    let mut cluster = Cluster::new(1, &[1], &[]);
    cluster.elect();
    cluster.join(2);
    cluster.join(3);
    follow(&mut cluster, &[1], &[2, 3]);
    follow(&mut cluster, &[1, 2, 3], &[]);
    // The founder shall vote no more: it hands over first.
    follow(&mut cluster, &[2, 3], &[1]);
    assert_ne!(cluster.leader(), Some(1));
    follow(&mut cluster, &[2, 3], &[]);
    cluster.join(4);
    follow(&mut cluster, &[2, 3, 4], &[]);
    cluster.crash(2);
    cluster.elect();
    // A dead voter is replaced while it is dead.
    cluster.join(5);
    follow(&mut cluster, &[3, 4, 5], &[]);
    cluster.until("all have all", 50, Cluster::converged);
    cluster.check_log_matching();
}

#[test]
fn ordering_hardly_pauses_when_all_voters_are_replaced() {
    let mut cluster = Cluster::new(2, &[1, 2, 3], &[]);
    cluster.elect();
    for id in 4..=6 {
        cluster.join(id);
    }
    cluster.want(wish(&[4, 5, 6], &[]));
    let (mut blocks, mut silent, mut longest) = (0, 0, 0);
    while cluster.members() != Membership::new([4, 5, 6], []) {
        for id in 1..=6 {
            cluster.submit(id, Lane::Data, &format!("{id}-{}", cluster.now));
        }
        cluster.run(1);
        silent = if cluster.chosen.len() == blocks { silent + 1 } else { 0 };
        blocks = cluster.chosen.len();
        longest = longest.max(silent);
        assert!(cluster.now < 10_000_000_000);
    }
    assert!(longest < 10, "found {longest} ticks without a block: less than an election timeout, as nobody failed");
    for id in 1..=3 {
        cluster.crash(id);
    }
    let leader = cluster.elect();
    assert!(leader >= 4);
}

#[test]
fn a_removed_node_that_never_heard_of_it_disturbs_nobody() {
    let mut cluster = Cluster::new(3, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    let victim = 1 + leader % 3;
    for id in 1..=3 {
        cluster.cut.extend([(victim, id), (id, victim)]);
    }
    let mut voters = vec![1, 2, 3];
    voters.retain(|id| *id != victim);
    follow(&mut cluster, &voters, &[]);
    let term = cluster.status(leader).role.term;
    cluster.run(200);
    cluster.cut.clear();
    for nth in 0..50 {
        cluster.submit(leader, Lane::Data, &format!("t{nth}"));
        cluster.run(10);
    }
    assert_eq!(cluster.leader(), Some(leader));
    assert_eq!(cluster.status(leader).role.term, term, "pre-vote and the leader's lease (Raft thesis §4.2.3)");
    assert!(cluster.nodes[&victim].members.is_voter(victim), "it still believes");
    assert_ne!(cluster.status(victim).role.role, Role::Leader);
    // Its vote requests do not win either when the leader is gone: the others hold its removal, it does not.
    cluster.crash(leader);
    cluster.run(200);
    assert_ne!(cluster.status(victim).role.role, Role::Leader);
}

#[test]
fn a_node_that_is_no_member_receives_nothing_and_stands_for_nothing() {
    let mut cluster = Cluster::new(4, &[1], &[]);
    cluster.elect();
    cluster.join(7);
    cluster.input(7, Input::Campaign);
    cluster.submit(1, Lane::Data, "one");
    cluster.run(100);
    assert!(cluster.height(7) == 0);
    assert_eq!(cluster.status(7).role.term, 0);
    cluster.input(1, Input::ChangeMembership(MembershipChange::new([Change::AddLearner(7)])));
    cluster.until("the learner has all", 50, Cluster::converged);
}

#[test]
fn a_transfer_waits_for_a_target_that_is_behind_and_is_seen_meanwhile() {
    let mut cluster = Cluster::new(5, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    let to = 1 + leader % 3;
    // Its acknowledgements take their time, so it counts as behind.
    cluster.submit(leader, Lane::Data, "just now");
    cluster.input(leader, Input::TransferLeadership { to });
    assert_eq!(cluster.status(leader).transferring_to, Some(to));
    assert!(!cluster.status(leader).may_propose);
    cluster.input(leader, Input::TransferLeadership { to });
    assert!(cluster.nodes[&leader].refused.is_empty(), "the same again is nothing new");
    cluster.input(leader, Input::TransferLeadership { to: 6 - leader - to });
    assert_eq!(cluster.nodes[&leader].refused.last().unwrap().1.code, Code::Overloaded);
    cluster.until("the other leads", 10, |cluster| cluster.leader() == Some(to));
    assert!(cluster.has_executed(to, "just now"));
    assert_eq!(cluster.status(leader).transferring_to, None);
}

#[test]
fn a_transfer_that_fails_ends_after_an_election_timeout_and_ordering_goes_on() {
    let mut cluster = Cluster::new(6, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    let to = 1 + leader % 3;
    cluster.cut.insert((leader, to));
    cluster.submit(leader, Lane::Data, "before");
    cluster.input(leader, Input::TransferLeadership { to });
    assert_eq!(cluster.status(leader).transferring_to, Some(to));
    cluster.until("the transfer has failed", 21, |cluster| cluster.status(leader).transferring_to.is_none());
    let status = cluster.status(leader);
    assert!(status.may_propose && status.transfer_rests);
    cluster.submit(leader, Lane::Data, "after");
    cluster.until("ordering goes on", 10, |cluster| cluster.has_executed(leader, "after"));
}

#[test]
fn a_silent_target_is_refused_at_once() {
    let mut cluster = Cluster::new(7, &[1, 2, 3], &[]);
    let leader = cluster.elect();
    let to = 1 + leader % 3;
    cluster.crash(to);
    cluster.run(30);
    cluster.input(leader, Input::TransferLeadership { to });
    assert_eq!(cluster.nodes[&leader].refused.last().unwrap().1.code, Code::Overloaded);
    assert!(cluster.status(leader).may_propose, "nothing has paused");
    assert_eq!(ledger_raft::successor(&cluster.status(leader)), Some(6 - leader - to));
}
