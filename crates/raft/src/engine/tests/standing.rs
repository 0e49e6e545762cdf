//! Messages of those who may not send them change nothing.

use super::*;
use crate::engine::standing::{LEARNER_LOOK_TIMEOUTS, LOOK_TIMEOUTS};
use crate::message::Transactions;
use bytes::Bytes;
use ledger::members::{Change, MembershipChange};

/// Node 2 of the voters 1, 2 and 3 follows node 1 in term 1; node 9 learns.
fn follower() -> Engine {
    let mut engine = engine(2, &[1, 2, 3], &[9]);
    step(&mut engine, message(1, RaftKind::Heartbeat, |_| {}));
    assert_eq!(engine.leader(), Some(1));
    engine
}

/// A change of the members, as the log has it.
fn promote(node: u64) -> Bytes {
    MembershipChange::new([Change::AddVoter(node)]).to_bytes()
}

fn is_ignored(out: &[Output]) -> bool {
    matches!(out, [Output::Ignored { .. }])
}

fn failed(out: &[Output]) -> bool {
    out.iter().any(|output| matches!(output, Output::Failed(_)))
}

#[test]
fn a_learner_neither_leads_nor_votes_nor_ends_a_term() {
    for kind in [
        RaftKind::Append,
        RaftKind::Heartbeat,
        RaftKind::TimeoutNow,
        RaftKind::Vote,
        RaftKind::PreVote,
        RaftKind::VoteResponse,
        RaftKind::PreVoteResponse,
        RaftKind::ReadIndexResponse,
    ] {
        for (mut node, role) in [(follower(), "follower"), (leader(1), "leader")] {
            node.membership = Membership::new([1, 2, 3], [9]);
            let before = (node.raw.raft.term, node.leader());
            let out = step(&mut node, message(9, kind, |message| message.term = 1_000));
            assert!(is_ignored(&out), "{kind:?} to a {role}: {out:?}");
            assert_eq!((node.raw.raft.term, node.leader()), before, "{kind:?} to a {role}");
        }
    }
}

#[test]
fn a_read_that_reaches_a_follower_is_not_passed_on_in_its_name() {
    let mut node = follower();
    let read = message(3, RaftKind::ReadIndex, |message| {
        message.term = 0;
        message.context = vec![7; 24].into();
    });
    let out = step(&mut node, read);
    assert!(is_ignored(&out), "{out:?}");
}

#[test]
fn a_commit_index_alone_ends_no_process() {
    for from in [1, 3, 9] {
        let mut node = follower();
        let out =
            step(&mut node, message(from, RaftKind::Heartbeat, |message| (message.term, message.commit) = (2, 999)));
        assert!(!failed(&out) && !node.failed, "{from}: {out:?}");
    }
}

#[test]
fn a_voter_stops_and_a_learner_asks_for_blocks_when_the_leader_shows_their_receipt_for_what_they_do_not_hold() {
    let append = |count: u64| {
        let entries = (1..=count).map(|index| WireEntry { index, term: 1, kind: 1, data: Bytes::new() }).collect();
        message(1, RaftKind::Append, |message| message.entries = entries)
    };
    let receipts = |out: &[Output]| -> Vec<(u64, Bytes)> {
        let sent = out.iter().filter_map(|output| match output {
            Output::Send { to: 1, message: PeerMessage::Raft(message) } => {
                Some((message.index, message.receipt.clone()))
            }
            _ => None,
        });
        sent.filter(|(_, receipt)| !receipt.is_empty()).collect()
    };
    let acknowledged = receipts(&step(&mut follower(), append(3)));
    let (index, receipt) = acknowledged.last().cloned().unwrap();
    assert_eq!(index, 3);
    let shown = |index: u64, receipt: &Bytes, term: u64| {
        let receipt = receipt.clone();
        message(1, RaftKind::Heartbeat, move |message| {
            (message.term, message.receipt_index, message.receipt) = (term, index, receipt);
        })
    };
    // The same node after its disk was set back to an older state.
    let lost = || {
        let mut node = follower();
        step(&mut node, append(1));
        node
    };
    assert!(failed(&step(&mut lost(), shown(3, &receipt, 1))), "its own receipt");
    assert!(!failed(&step(&mut lost(), shown(4, &receipt, 1))), "a receipt of another block");
    assert!(!failed(&step(&mut lost(), shown(3, &receipt, 2))), "a receipt of another term");
    assert!(!failed(&step(&mut lost(), shown(3, &Bytes::from_static(&[7; 32]), 1))), "made up");
    let mut learner = lost();
    learner.membership = Membership::new([1, 3], [2]);
    let fetches = Output::Behind { from: 1, first_index: 4 };
    assert_eq!(step(&mut learner, shown(3, &receipt, 1)), [fetches], "a learner has promised nothing");
    let mut kept = follower();
    step(&mut kept, append(3));
    assert!(!failed(&step(&mut kept, shown(3, &receipt, 1))), "it holds the block");
}

#[test]
fn a_leader_shows_each_follower_its_newest_receipt_of_this_term() {
    let mut node = leader(2);
    for (index, byte) in [(2, 5), (3, 6), (1, 7)] {
        let receipt = Bytes::from(vec![byte; 32]);
        step(
            &mut node,
            message(3, RaftKind::AppendResponse, |message| (message.index, message.receipt) = (index, receipt)),
        );
    }
    let out: Vec<Output> = (0..10).flat_map(|_| step(&mut node, Input::Tick)).collect();
    let shown = |to: u64| {
        let found = out.iter().find_map(|output| match output {
            Output::Send { to: receiver, message: PeerMessage::Raft(message) } if *receiver == to => (message.kind
                == i32::from(RaftKind::Heartbeat))
            .then(|| (message.receipt_index, message.receipt.clone())),
            _ => None,
        });
        found.unwrap()
    };
    assert_eq!(shown(3), (3, Bytes::from(vec![6; 32])));
    assert_eq!(shown(2), (0, Bytes::new()), "it has shown none");
}

#[test]
fn a_leader_stands_for_election_again_for_a_member_in_a_later_term_but_not_again_for_a_while() {
    let stuck = |from: u64, term: u64| message(from, RaftKind::AppendResponse, move |message| message.term = term);
    let elects = |node: &mut Engine| {
        let term = node.raw.raft.term;
        step(node, message(2, RaftKind::VoteResponse, move |message| message.term = term));
        assert!(node.is_leader());
        term
    };
    let mut node = leader(1);
    node.membership = Membership::new([1, 2, 3], [8, 9]);
    for (from, others) in [(3, [3, 3]), (9, [8, 9])] {
        let before = node.raw.raft.term;
        let out = step(&mut node, stuck(from, before + 4));
        let asks = |output: &Output| match output {
            Output::Send { to: 2, message: PeerMessage::Raft(message) } => {
                message.kind == i32::from(RaftKind::Vote) && message.context[..] == *raft::CAMPAIGN_TRANSFER
            }
            _ => false,
        };
        assert!(out.iter().any(asks), "in spite of its own lease: {out:?}");
        assert_eq!(elects(&mut node), before + 5);
        for other in others {
            let term = node.raw.raft.term;
            step(&mut node, stuck(other, term + 1));
            assert!(node.is_leader() && node.raw.raft.term == term, "not so soon");
        }
    }
    node.ticks += REST;
    let term = node.raw.raft.term;
    step(&mut node, stuck(8, term + 1));
    assert_eq!(elects(&mut node), term + 2);
    let last = node.raw.raft.term;
    step(&mut node, stuck(7, last + 1));
    assert!(node.is_leader(), "one that is no member");
}

const REST: u64 = super::super::standing::REST_TIMEOUTS * 20;

#[test]
fn the_term_of_a_vote_cannot_use_up_the_terms_that_there_are() {
    let mut node = engine(2, &[1, 2, 3], &[]);
    let vote = |term: u64| message(1, RaftKind::Vote, move |message| message.term = term);
    assert!(is_ignored(&step(&mut node, vote(1 << 40))));
    assert_eq!(node.raw.raft.term, 0);
    step(&mut node, vote(1 << 20));
    assert_eq!(node.raw.raft.term, 1 << 20);
}

#[test]
fn a_voter_that_a_change_in_the_log_makes_is_believed_before_the_change_is_committed() {
    let mut node = follower();
    let lead = |term: u64| message(9, RaftKind::Heartbeat, move |message| message.term = term);
    assert!(is_ignored(&step(&mut node, lead(2))));
    let entries = vec![WireEntry { index: 1, term: 1, kind: 3, data: promote(9) }];
    step(&mut node, message(1, RaftKind::Append, |message| message.entries = entries));
    assert!(!node.membership.is_voter(9), "it is not committed");
    step(&mut node, mandate(2, 9, &[1, 3, 9]));
    step(&mut node, lead(2));
    assert_eq!(node.leader(), Some(9));
}

#[test]
fn a_node_that_hears_only_unknown_leaders_asks_its_peers_for_blocks() {
    let wait = |node: &mut Engine, from: Option<u64>| {
        let mut out = Vec::new();
        for _ in 0..300 {
            out.extend(from.map(|from| step(node, message(from, RaftKind::Heartbeat, |message| message.term = 50))));
            out.push(step(node, Input::Tick));
        }
        out.into_iter().flatten().filter(|output| matches!(output, Output::Behind { .. })).count()
    };
    assert_eq!(wait(&mut follower(), Some(7)), 1, "of the voters only others speak");
    assert_eq!(wait(&mut follower(), None), 0, "nobody speaks");
}

#[test]
fn a_learner_follows_no_leader_of_which_it_does_not_know_that_it_votes_and_asks_its_peers_soon() {
    let lead = |from: u64, term: u64| message(from, RaftKind::Heartbeat, move |message| message.term = term);
    let mut learner = engine(9, &[1, 2, 3], &[9]);
    let mut asked_after = None;
    for tick in 0..LOOK_TIMEOUTS * learner.config.election_tick {
        assert!(is_ignored(&step(&mut learner, lead(7, 1))));
        let out = step(&mut learner, Input::Tick);
        if out.iter().any(|output| matches!(output, Output::Behind { .. })) {
            asked_after = asked_after.or(Some(tick));
        }
    }
    assert_eq!(learner.leader(), None);
    assert!(asked_after.is_some_and(|ticks| ticks <= LEARNER_LOOK_TIMEOUTS * learner.config.election_tick));
    let mut learner = engine(9, &[1, 2, 3], &[9]);
    step(&mut learner, mandate(1, 1, &[1, 2]));
    step(&mut learner, lead(1, 1));
    assert!(is_ignored(&step(&mut learner, lead(7, 2))));
    assert_eq!(learner.leader(), Some(1));
}

#[test]
fn a_learner_that_a_change_in_its_log_makes_a_voter_follows_no_stranger() {
    let mut node = engine(9, &[1, 2, 3], &[9]);
    let entries = vec![WireEntry { index: 1, term: 1, kind: 3, data: promote(9) }];
    step(&mut node, message(1, RaftKind::Append, |message| message.entries = entries));
    assert!(!node.is_voter(), "it is not committed");
    for _ in 0..=2 * node.config.election_tick {
        step(&mut node, Input::Tick);
    }
    assert_eq!(node.leader(), None);
    assert!(is_ignored(&step(&mut node, message(7, RaftKind::Heartbeat, |message| message.term = 2))));
    assert_eq!(node.leader(), None);
    let out: Vec<Output> = (0..300).flat_map(|_| step(&mut node, Input::Tick)).collect();
    assert!(out.iter().any(|output| matches!(output, Output::Behind { .. })), "its peers may have the blocks: {out:?}");
}

#[test]
fn only_the_leader_says_that_a_transaction_was_not_ordered_and_only_for_its_own_trouble() {
    let returned = |from: u64, code: Code| Input::Message {
        from,
        message: PeerMessage::Returned(Transactions {
            control: vec![Bytes::from_static(b"stop")],
            data: Vec::new(),
            code: code.number().into(),
        }),
    };
    let reason = |out: Vec<Output>| match out.into_iter().next() {
        Some(Output::Dropped { reason, .. }) => Some(reason.code),
        _ => None,
    };
    assert!(is_ignored(&step(&mut follower(), returned(3, Code::Overloaded))));
    assert!(is_ignored(&step(&mut follower(), returned(9, Code::Overloaded))));
    assert_eq!(reason(step(&mut follower(), returned(1, Code::Overloaded))), Some(Code::Overloaded));
    assert_eq!(reason(step(&mut follower(), returned(1, Code::Revoked))), Some(Code::NoLeader));
}
