#![expect(clippy::panic, reason = "tests")]

use super::*;
use crate::engine::Replication;
use crate::interface::{Role, RoleChange};
use crate::queue::QueueStatus;
use ledger::members::Membership;

/// How node 1 sees things as the leader: every peer has everything and answers.
fn leader(voters: &[u64], learners: &[u64]) -> Status {
    let membership = Membership::new(voters.iter().copied(), learners.iter().copied());
    let peers = membership.nodes().into_iter().filter(|node| *node != 1);
    let peers = peers
        .map(|node| PeerStatus {
            node,
            matched: 5000,
            next: 5001,
            replication: Replication::Streaming,
            recently_active: true,
            receipt: None,
        })
        .collect();
    Status {
        id: 1,
        role: RoleChange { leader: Some(1), term: 2, role: Role::Leader },
        commit: 5000,
        applied: 5000,
        persisted: 5000,
        first: 1,
        last: 5000,
        may_propose: true,
        changing: false,
        transferring_to: None,
        transfer_rests: false,
        membership,
        peers,
        control: QueueStatus::default(),
        data: QueueStatus::default(),
        depositions: 0,
        excluded: BTreeSet::new(),
        deposed: Vec::new(),
    }
}

fn desired(voters: &[u64], learners: &[u64]) -> Desired {
    let [voters, learners] = [voters, learners].map(|nodes| nodes.iter().copied().collect());
    Desired { voters, learners, ..Desired::default() }
}

fn peer_mut(status: &mut Status, node: u64) -> &mut PeerStatus {
    let Some(peer) = status.peers.iter_mut().find(|peer| peer.node == node) else { panic!("no peer {node}") };
    peer
}

fn changes(changes: &[Change]) -> Option<Input> {
    Some(change(changes.iter().copied()))
}

#[test]
fn nothing_is_left_to_do_when_the_members_are_those_desired() {
    assert_eq!(next_step(&desired(&[1, 2, 3], &[4]), &leader(&[1, 2, 3], &[4])), None);
}

#[test]
fn nothing_is_done_meanwhile_or_by_others_or_for_an_empty_wish() {
    let wish = desired(&[1, 2, 3], &[]);
    assert!(next_step(&wish, &leader(&[1, 2], &[])).is_some());
    assert_eq!(next_step(&wish, &Status { may_propose: false, ..leader(&[1, 2], &[]) }), None);
    assert_eq!(next_step(&wish, &Status { changing: true, ..leader(&[1, 2], &[]) }), None);
    assert_eq!(next_step(&wish, &Status { transferring_to: Some(2), ..leader(&[1, 2], &[]) }), None);
    assert_eq!(next_step(&desired(&[], &[1, 2]), &leader(&[1, 2], &[])), None);
}

#[test]
fn a_new_voter_comes_in_as_a_learner_and_is_promoted_when_it_has_caught_up() {
    let wish = desired(&[1, 2], &[]);
    assert_eq!(next_step(&wish, &leader(&[1], &[])), changes(&[Change::AddLearner(2)]));
    let mut status = leader(&[1], &[2]);
    peer_mut(&mut status, 2).matched = 5000 - PROMOTION_LAG_MAX - 1;
    assert_eq!(next_step(&wish, &status), None, "too far behind");
    peer_mut(&mut status, 2).matched += 1;
    assert_eq!(next_step(&wish, &status), changes(&[Change::AddVoter(2)]));
    peer_mut(&mut status, 2).recently_active = false;
    assert_eq!(next_step(&wish, &status), None, "silent");
}

#[test]
fn a_node_that_needs_blocks_which_the_leader_has_dropped_is_no_voter_yet_and_counts_in_no_majority() {
    let mut status = Status { first: 4900, ..leader(&[1], &[2]) };
    peer_mut(&mut status, 2).matched = 4898;
    assert_eq!(next_step(&desired(&[1, 2], &[]), &status), None, "block 4899 is gone");
    peer_mut(&mut status, 2).matched = 4899;
    assert_eq!(next_step(&desired(&[1, 2], &[]), &status), changes(&[Change::AddVoter(2)]));
    let mut status = Status { first: 4900, ..leader(&[1, 2, 3], &[]) };
    peer_mut(&mut status, 2).matched = 4000;
    assert_eq!(next_step(&desired(&[1, 2], &[3]), &status), None, "2 and 1 alone could not order");
}

#[test]
fn a_node_of_which_nothing_is_known_is_not_caught_up_however_short_the_chain() {
    let mut status = leader(&[1], &[2]);
    (status.commit, peer_mut(&mut status, 2).matched) = (3, 0);
    assert_eq!(next_step(&desired(&[1, 2], &[]), &status), None);
}

#[test]
fn a_voter_is_replaced_in_one_joint_change() {
    let wish = desired(&[1, 2, 4], &[]);
    assert_eq!(next_step(&wish, &leader(&[1, 2, 3], &[])), changes(&[Change::AddLearner(4)]));
    let mut status = leader(&[1, 2, 3], &[4]);
    assert_eq!(next_step(&wish, &status), changes(&[Change::AddVoter(4), Change::Remove(3)]));
    peer_mut(&mut status, 4).matched = 7;
    assert_eq!(next_step(&wish, &status), None, "the replacement is on its way");
    peer_mut(&mut status, 4).recently_active = false;
    assert_eq!(next_step(&wish, &status), changes(&[Change::Remove(3)]), "a silent one holds nothing up");
}

#[test]
fn a_node_that_joins_again_keeps_its_vote_until_its_new_number_has_it_unless_it_has_lied() {
    let wish = Desired { replacements: [(3, 4)].into(), ..desired(&[1, 2, 4], &[]) };
    let mut status = leader(&[1, 2, 3], &[4]);
    (peer_mut(&mut status, 4).matched, peer_mut(&mut status, 4).recently_active) = (0, false);
    assert_eq!(next_step(&wish, &status), None, "two voters would need both");
    status.excluded.insert(3);
    assert_eq!(
        next_step(&wish, &status),
        changes(&[Change::Remove(3)]),
        "a liar does not keep its vote by joining again"
    );
    status.excluded.clear();
    (peer_mut(&mut status, 4).matched, peer_mut(&mut status, 4).recently_active) = (5000, true);
    assert_eq!(next_step(&wish, &status), changes(&[Change::AddVoter(4), Change::Remove(3)]));
}

#[test]
fn a_voter_that_shall_follow_becomes_a_learner_and_a_dead_one_can_be_removed() {
    assert_eq!(next_step(&desired(&[1, 2], &[3]), &leader(&[1, 2, 3], &[])), changes(&[Change::AddLearner(3)]));
    let mut status = leader(&[1, 2, 3], &[]);
    peer_mut(&mut status, 3).recently_active = false;
    assert_eq!(next_step(&desired(&[1, 2], &[]), &status), changes(&[Change::Remove(3)]));
}

#[test]
fn no_change_leads_to_voters_of_which_a_majority_is_dead_or_far_behind() {
    let mut status = leader(&[1, 2, 3], &[]);
    peer_mut(&mut status, 3).recently_active = false;
    assert_eq!(next_step(&desired(&[1, 3], &[2]), &status), None, "1 and 3 could not order without 3");
    let mut status = leader(&[1, 2, 3], &[]);
    peer_mut(&mut status, 3).matched = 10;
    assert_eq!(next_step(&desired(&[1, 3], &[2]), &status), None);
}

#[test]
fn a_leader_that_shall_go_hands_over_to_the_desired_voter_that_lacks_least() {
    let mut status = leader(&[1, 2, 3, 4], &[]);
    peer_mut(&mut status, 2).matched = 4990;
    let wish = desired(&[2, 3, 4], &[1]);
    assert_eq!(next_step(&wish, &status), Some(Input::TransferLeadership { to: 3 }));
    peer_mut(&mut status, 3).recently_active = false;
    assert_eq!(next_step(&wish, &status), Some(Input::TransferLeadership { to: 4 }));
    assert_eq!(next_step(&wish, &Status { transfer_rests: true, ..status }), None, "each attempt stops the ordering");
}

#[test]
fn the_only_voter_is_replaced_by_promotion_then_transfer() {
    let wish = desired(&[2], &[]);
    assert_eq!(next_step(&wish, &leader(&[1], &[2])), changes(&[Change::AddVoter(2)]));
    assert_eq!(next_step(&wish, &leader(&[1, 2], &[])), Some(Input::TransferLeadership { to: 2 }));
    // Then node 2 leads; the same from its side.
    let status = Status { id: 1, ..leader(&[1, 2], &[]) };
    assert_eq!(next_step(&desired(&[1], &[]), &status), changes(&[Change::Remove(2)]));
}

#[test]
fn learners_that_are_not_desired_go_last() {
    let wish = desired(&[1, 3], &[]);
    assert_eq!(next_step(&wish, &leader(&[1], &[3, 9])), changes(&[Change::AddVoter(3)]));
    assert_eq!(next_step(&wish, &leader(&[1, 3], &[9])), changes(&[Change::Remove(9)]));
}

#[test]
fn a_node_in_both_sets_votes() {
    assert_eq!(next_step(&desired(&[1, 2], &[2]), &leader(&[1], &[2])), changes(&[Change::AddVoter(2)]));
    assert_eq!(next_step(&desired(&[1, 2], &[2]), &leader(&[1, 2], &[])), None);
}

#[test]
fn the_successor_is_the_voter_that_answers_and_lacks_least() {
    let mut status = leader(&[1, 2, 3], &[4]);
    assert_eq!(successor(&status), Some(2), "the lowest id of several");
    peer_mut(&mut status, 2).matched = 4999;
    assert_eq!(successor(&status), Some(3));
    peer_mut(&mut status, 3).recently_active = false;
    assert_eq!(successor(&status), Some(2));
    peer_mut(&mut status, 2).recently_active = false;
    assert_eq!(successor(&status), None, "a learner cannot lead");
}

/// The steps lead to any desired membership, through voters that can order at every moment.
#[test]
fn the_steps_end_at_what_is_desired() {
    for bits in 0..3_u32.pow(5) {
        let role = |node: u64| bits / 3_u32.pow(u32::try_from(node - 1).unwrap_or(0)) % 3;
        let of = |wanted: u32| (1..=5).filter(|node| role(*node) == wanted).collect::<Vec<u64>>();
        let wish = desired(&of(1), &of(2));
        if wish.voters.is_empty() {
            continue;
        }
        let (mut membership, mut id) = (Membership::new([1, 2, 3], [4]), 1);
        let mut steps = 0;
        loop {
            let voters: Vec<u64> = membership.voters.iter().copied().collect();
            let learners: Vec<u64> = membership.learners.iter().copied().collect();
            let mut status = Status { id, ..leader(&voters, &learners) };
            status.peers.retain(|peer| peer.node != id);
            if id != 1 && membership.contains(1) {
                let one = PeerStatus { node: 1, ..leader(&[1, 2], &[]).peers.remove(0) };
                status.peers.push(one);
            }
            match next_step(&wish, &status) {
                None => break,
                Some(Input::TransferLeadership { to }) => id = to,
                Some(Input::ChangeMembership(change)) => {
                    membership = membership.apply(&change).unwrap_or_else(|error| panic!("{error}: {change:?}"));
                    if membership.is_joint() {
                        membership =
                            membership.apply(&MembershipChange::default()).unwrap_or_else(|error| panic!("{error}"));
                    }
                    assert!(membership.voters.contains(&id), "the leader keeps its vote");
                }
                other => panic!("{other:?}"),
            }
            steps += 1;
            assert!(steps < 20, "{wish:?} from {membership:?}");
        }
        assert_eq!((&membership.voters, &membership.learners), (&wish.voters, &wish.learners));
    }
}
