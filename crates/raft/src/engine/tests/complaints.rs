//! A leader that withholds control calls is deposed by more voters than one hand has, and by nobody else.

use super::votes::signed_complaint;
use super::*;
use crate::engine::complaints::{BAN_TIMEOUTS, DEPOSED_TIMEOUTS, FORGET_TIMEOUTS};
use crate::engine::status::Deposition;
use crate::message::SignedComplaint;

/// Node 2 of five voters follows node 1 in term 1. Two complaints are needed, see [`Names`].
fn follower() -> Engine {
    let mut engine = engine(2, &[1, 2, 3, 4, 5], &[9]);
    step(&mut engine, message(1, RaftKind::Heartbeat, |_| {}));
    assert_eq!(engine.leader(), Some(1));
    engine
}

fn complaint(from: u64, term: u64, leader: u64, signed: Bytes) -> Input {
    Input::Message { from, message: PeerMessage::Complaint(SignedComplaint { term, leader, signed }) }
}

/// An honest complaint of a voter about node 1 in term 1.
fn honest_complaint(from: u64) -> Input {
    complaint(from, 1, 1, signed_complaint(Grievance { term: 1, leader: 1, voter: from }))
}

fn own() -> Input {
    Input::Complain { term: 1, leader: 1 }
}

fn deposed() -> Engine {
    let mut node = follower();
    step(&mut node, own());
    step(&mut node, honest_complaint(3));
    assert_eq!(node.leader(), None);
    node
}

fn ticks(node: &mut Engine, count: u64) -> Vec<Output> {
    (0..count).flat_map(|_| step(node, Input::Tick)).collect()
}

fn timeout(node: &Engine) -> u64 {
    node.config.election_tick as u64
}

/// A request for a pre-vote, in the next term.
fn asks(from: u64) -> Input {
    message(from, RaftKind::PreVote, |message| (message.term, message.log_term, message.index) = (2, 1, 9))
}

fn grants(out: &[Output], candidate: u64) -> bool {
    out.iter().any(|output| match output {
        Output::Send { to, message: PeerMessage::Raft(message) } => {
            *to == candidate && message.kind() == RaftKind::PreVoteResponse && !message.reject
        }
        _ => false,
    })
}

#[test]
fn a_voter_signs_its_complaint_and_sends_it_to_the_voters_for_as_long_as_it_lasts() {
    let mut node = follower();
    let sent = |out: &[Output]| -> Vec<u64> {
        let to = out.iter().filter_map(|output| match output {
            Output::Send { to, message: PeerMessage::Complaint(complaint) } => {
                assert_eq!(complaint.signed, signed_complaint(Grievance { term: 1, leader: 1, voter: 2 }));
                Some(*to)
            }
            _ => None,
        });
        to.collect()
    };
    assert_eq!(sent(&step(&mut node, own())), [1, 3, 4, 5], "the leader as well: an honest one steps down");
    assert_eq!(sent(&step(&mut node, own())), [0; 0], "not again at once");
    for _ in 0..3 * timeout(&node) {
        step(&mut node, message(1, RaftKind::Heartbeat, |_| {}));
        step(&mut node, Input::Tick);
    }
    assert_eq!(sent(&step(&mut node, own())), [1, 3, 4, 5]);
    for other in [Input::Complain { term: 2, leader: 1 }, Input::Complain { term: 1, leader: 3 }] {
        assert_eq!(sent(&step(&mut follower(), other)), [0; 0], "it does not lead in this term");
    }
    let mut learner = engine(9, &[1, 2, 3, 4, 5], &[9]);
    step(&mut learner, message(1, RaftKind::Heartbeat, |_| {}));
    assert_eq!(sent(&step(&mut learner, own())), [0; 0], "a learner has no voice");
}

#[test]
fn the_status_names_deposed_leaders_for_an_hour_and_counts_all_depositions() {
    let mut node = deposed();
    let seen = |node: &Engine| (node.status().depositions, node.status().deposed);
    let once = Deposition { leader: 1, times: 1, time: node.now };
    assert_eq!(seen(&node), (1, vec![once]));
    assert_eq!(seen(&follower()), (0, Vec::new()));
    node.ticks += FORGET_TIMEOUTS * timeout(&node);
    assert_eq!(seen(&node), (1, Vec::new()));
}

#[test]
fn complaints_of_more_voters_than_one_hand_has_depose_the_leader_of_this_term_and_fewer_do_not() {
    deposed();
    let signed = |grievance| signed_complaint(grievance);
    let good = Grievance { term: 1, leader: 1, voter: 3 };
    for (other, why) in [
        (own(), "the same voter again"),
        (complaint(3, 1, 1, Bytes::new()), "unsigned"),
        (complaint(3, 1, 1, signed(Grievance { voter: 4, ..good })), "signed by another voter"),
        (complaint(3, 1, 1, signed(Grievance { term: 2, ..good })), "for another term"),
        (complaint(3, 1, 1, signed(Grievance { leader: 4, ..good })), "about another leader"),
        (complaint(3, 2, 1, signed(Grievance { term: 2, ..good })), "about another term"),
        (complaint(3, 1, 4, signed(Grievance { leader: 4, ..good })), "about a node that does not lead"),
        (complaint(9, 1, 1, signed(Grievance { voter: 9, ..good })), "of a learner"),
        (complaint(1, 1, 1, signed(Grievance { voter: 1, ..good })), "of the leader itself"),
    ] {
        let mut node = follower();
        step(&mut node, own());
        step(&mut node, other);
        assert_eq!(node.leader(), Some(1), "{why}");
    }
    let mut node = follower();
    step(&mut node, own());
    step(&mut node, message(1, RaftKind::Heartbeat, |message| message.term = 2));
    let later = complaint(3, 2, 1, signed(Grievance { term: 2, ..good }));
    step(&mut node, later);
    assert_eq!(node.leader(), Some(1), "complaints of two terms do not add up");
}

#[test]
fn a_voter_in_a_later_term_counts_as_one_that_complains_for_a_voter_that_complains_itself() {
    let campaign = |from, term| {
        message(from, RaftKind::PreVote, move |message| (message.term, message.log_term, message.index) = (term, 1, 0))
    };
    let mut node = follower();
    step(&mut node, campaign(3, 3));
    assert_eq!(node.leader(), Some(1), "it does not complain itself");
    step(&mut node, own());
    for (other, why) in
        [(campaign(3, 2), "of this term"), (campaign(9, 3), "a learner"), (campaign(1, 3), "the leader")]
    {
        step(&mut node, other);
        assert_eq!(node.leader(), Some(1), "{why}");
    }
    step(&mut node, campaign(3, 3));
    assert_eq!(node.leader(), None);
}

#[test]
fn nothing_more_is_taken_from_a_deposed_leader_for_a_while_and_campaigns_are_honoured_although_it_lives() {
    let mut node = follower();
    assert!(!grants(&step(&mut node, asks(4)), 4), "the leader lives");
    let mut node = deposed();
    let append = |node: &mut Engine| {
        step(node, message(1, RaftKind::Heartbeat, |_| {}));
        node.leader()
    };
    assert_eq!(append(&mut node), None);
    assert!(grants(&step(&mut node, asks(4)), 4));
    let mut node = deposed();
    let two = 2 * timeout(&node);
    let out = ticks(&mut node, two);
    let stands = |output: &Output| matches!(output, Output::Send { message: PeerMessage::Raft(message), .. } if message.kind() == RaftKind::PreVote);
    assert!(out.iter().any(stands), "it stands for election itself");
    let rest = (DEPOSED_TIMEOUTS - 2) * timeout(&node);
    ticks(&mut node, rest - 1);
    assert_eq!(append(&mut node), None);
    ticks(&mut node, 1);
    let term = node.raw.raft.term;
    step(&mut node, message(1, RaftKind::Heartbeat, |message| message.term = term));
    assert_eq!(node.leader(), Some(1), "nobody else was elected");
}

#[test]
fn a_deposed_leader_gets_no_vote_for_ten_seconds_and_twice_as_long_each_time() {
    let mut node = deposed();
    let term = node.raw.raft.term;
    for times in 0..3 {
        let ban = (BAN_TIMEOUTS * timeout(&node)) << times;
        let ask = |node: &mut Engine| {
            // Nobody leads.
            node.raw.raft.become_follower(term, raft::INVALID_ID);
            let out = step(node, asks(1));
            grants(&out, 1)
        };
        node.ticks += ban - 1;
        assert!(!ask(&mut node), "{times}");
        node.ticks += 1;
        assert!(ask(&mut node), "{times}");
        step(&mut node, message(1, RaftKind::Heartbeat, |_| {}));
        step(&mut node, honest_complaint(4));
        step(&mut node, honest_complaint(3));
        assert_eq!(node.leader(), None);
    }
}

#[test]
fn an_honest_leader_that_counts_the_complaints_steps_down_and_does_not_stand_for_election() {
    let mut node = leader(1);
    step(&mut node, honest_complaint(2));
    assert!(node.is_leader());
    step(&mut node, honest_complaint(3));
    assert!(!node.is_leader());
    let long = 10 * timeout(&node);
    let out = ticks(&mut node, long);
    let asks = |output: &Output| matches!(output, Output::Send { message: PeerMessage::Raft(message), .. } if matches!(message.kind(), RaftKind::PreVote | RaftKind::Vote));
    assert!(!out.iter().any(asks));
}
