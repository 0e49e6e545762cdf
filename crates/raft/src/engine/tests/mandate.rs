//! Nobody is followed in a new term before it has shown that a majority elected it.

use super::*;
use crate::engine::standing::LOOK_TIMEOUTS;
use crate::message::{Mandate, MandateWanted, SignedVote};
use ledger::members::{Change, MembershipChange};

const VOTERS: [u64; 3] = [1, 2, 3];
const NOBODY: [u64; 0] = [];

fn heartbeat(from: u64, term: u64) -> Input {
    message(from, RaftKind::Heartbeat, move |message| message.term = term)
}

/// Does node 2 of these voters follow node 1 in term 5 after it was shown this?
fn believes(voters: &[u64], shown: Input) -> bool {
    let mut node = engine(2, voters, &[9]);
    bare_step(&mut node, shown);
    bare_step(&mut node, heartbeat(1, 5));
    node.leader() == Some(1) && node.raw.raft.term == 5
}

fn wanted(out: &[Output]) -> Vec<(u64, u64)> {
    let asked = out.iter().filter_map(|output| match output {
        Output::Send { to, message: PeerMessage::MandateWanted(wanted) } => Some((*to, wanted.term)),
        _ => None,
    });
    asked.collect()
}

/// The mandates in these outputs: receiver, term and voters.
fn shown(out: &[Output]) -> Vec<(u64, u64, Vec<u64>)> {
    let mandates = out.iter().filter_map(|output| match output {
        Output::Send { to, message: PeerMessage::Mandate(mandate) } => {
            Some((*to, mandate.term, mandate.votes.iter().map(|vote| vote.node).collect()))
        }
        _ => None,
    });
    mandates.collect()
}

fn ask(from: u64, term: u64) -> Input {
    Input::Message { from, message: PeerMessage::MandateWanted(MandateWanted { term }) }
}

#[test]
fn a_voter_that_was_not_elected_leads_nobody_whatever_it_sends() {
    for kind in [RaftKind::Append, RaftKind::Heartbeat, RaftKind::TimeoutNow, RaftKind::ReadIndexResponse] {
        for node in [&mut engine(2, &VOTERS, &[]), &mut engine(9, &VOTERS, &[9]), &mut leader(1)] {
            let before = (node.raw.raft.term, node.leader(), node.raw.raft.raft_log.last_index());
            let entries = match kind {
                RaftKind::Append => vec![WireEntry { index: 1, term: 7, kind: 1, data: Bytes::new() }],
                _ => Vec::new(),
            };
            let lie = message(3, kind, |message| (message.term, message.commit, message.entries) = (7, 1, entries));
            bare_step(node, lie);
            let after = (node.raw.raft.term, node.leader(), node.raw.raft.raft_log.last_index());
            assert_eq!(after, before, "{kind:?} to node {}", node.config.id);
        }
    }
}

#[test]
fn a_majority_of_signed_votes_for_this_leader_and_term_is_a_mandate() {
    assert!(believes(&VOTERS, mandate(5, 1, &[1, 3])));
    assert!(believes(&VOTERS, mandate(5, 1, &[1, 2, 3])));
    assert!(believes(&[1, 2, 3, 4, 5], mandate(5, 1, &[1, 4, 5])));
}

#[test]
fn where_one_of_two_leaders_of_a_term_is_left_its_follower_of_the_other_is_found_in_the_next_term() {
    let mut node = engine(2, &VOTERS, &[]);
    bare_step(&mut node, mandate(5, 1, &[1, 3]));
    bare_step(&mut node, heartbeat(1, 5));
    assert_eq!(node.leader(), Some(1));
    let term_after = |node: &mut Engine, second: bool| {
        for _ in 0..2 * LOOK_TIMEOUTS * node.config.election_tick {
            if second {
                bare_step(node, mandate(5, 3, &[1, 3]));
            }
            bare_step(node, heartbeat(3, 5));
            bare_step(node, Input::Tick);
        }
        assert_eq!(node.leader(), None, "the first leader of a term stays the only one");
        node.raw.raft.term
    };
    assert_eq!(term_after(&mut node, false), 5, "one that has shown no votes ends no term");
    assert!(term_after(&mut node, true) > 5);
    let answer = bare_step(&mut node, heartbeat(3, 5));
    let later = |output: &Output| match output {
        Output::Send { to: 3, message: PeerMessage::Raft(message) } => message.term > 5,
        _ => false,
    };
    assert!(answer.iter().any(later), "so that the second one stands for election again: {answer:?}");
}

#[test]
fn a_voter_that_elected_the_leader_itself_needs_no_certificate_to_know_its_own_vote_and_the_leaders() {
    let unsigned = |voters: &[u64]| {
        let votes = voters.iter().map(|node| SignedVote { node: *node, signed: Bytes::new() }).collect();
        Input::Message { from: 1, message: PeerMessage::Mandate(Mandate { term: 5, votes }) }
    };
    assert!(!believes(&VOTERS, unsigned(&[1, 2])), "it has given its vote to nobody");
    let mut node = engine(2, &VOTERS, &[]);
    bare_step(&mut node, message(1, RaftKind::Vote, |vote| (vote.term, vote.index, vote.log_term) = (5, 9, 4)));
    assert_eq!((node.raw.raft.term, node.raw.raft.vote), (5, 1));
    bare_step(&mut node, unsigned(&[1, 3]));
    assert!(!node.mandates.is_elected(1, 5), "the vote of another one needs its signature");
    let ticks = node.config.heartbeat_tick;
    (0..ticks).for_each(|_| drop(bare_step(&mut node, Input::Tick)));
    bare_step(&mut node, unsigned(&[1, 2]));
    assert!(node.mandates.is_elected(1, 5));
}

#[test]
fn a_mandate_that_was_made_up_is_not_believed() {
    let with = |votes: &[(u64, Bytes)]| {
        let votes = votes.iter().map(|(node, signed)| SignedVote { node: *node, signed: signed.clone() }).collect();
        Input::Message { from: 1, message: PeerMessage::Mandate(Mandate { term: 5, votes }) }
    };
    let own = (1, signed(5, 1, 1));
    for (vote, why) in [
        (None, "its own vote alone"),
        (Some((3, signed(4, 1, 3))), "a vote of another term"),
        (Some((3, signed(5, 2, 3))), "a vote for another candidate"),
        (Some((3, signed(5, 1, 1))), "its own vote under another name"),
        (Some((3, Bytes::new())), "no signature"),
        (Some((9, signed(5, 1, 9))), "the vote of a learner"),
        (Some((7, signed(5, 1, 7))), "the vote of a stranger, or of a node that was removed"),
    ] {
        let votes: Vec<_> = [own.clone()].into_iter().chain(vote).collect();
        assert!(!believes(&VOTERS, with(&votes)), "{why}");
    }
    assert!(!believes(&[1, 2, 3, 4], mandate(5, 1, &[1, 3])), "half of the voters");
    assert!(!believes(&VOTERS, mandate(4, 1, &VOTERS)), "a mandate for another term");
    let of_another = Input::Message {
        from: 1,
        message: match mandate(5, 3, &VOTERS) {
            Input::Message { message, .. } => message,
            _ => unreachable!("it is a message"),
        },
    };
    assert!(!believes(&VOTERS, of_another), "the mandate of another node");
    let twice = Mandate { term: 5, votes: vec![SignedVote { node: 1, signed: signed(5, 1, 1) }; 2] };
    assert!(PeerMessage::decode(PeerMessage::Mandate(twice).to_bytes()).is_err(), "a node counts once");
}

#[test]
fn while_voters_change_both_sets_must_have_elected_the_leader() {
    let believes = |voters: &[u64]| {
        let mut node = engine(2, &[1, 2, 3, 6, 7], &[]);
        node.membership.outgoing = [2, 4, 5].into();
        bare_step(&mut node, mandate(5, 1, voters));
        bare_step(&mut node, heartbeat(1, 5));
        node.leader() == Some(1)
    };
    assert!(!believes(&[1, 3, 6]), "nobody of those before");
    assert!(!believes(&[1, 4, 5]), "too few of those after");
    assert!(believes(&[1, 3, 4, 5, 6]));
}

#[test]
fn a_change_in_the_log_says_whose_votes_count_before_it_is_committed() {
    let promote = MembershipChange::new([Change::AddVoter(9)]).to_bytes();
    let mut node = engine(2, &[1, 2], &[9]);
    let entries = vec![WireEntry { index: 1, term: 1, kind: 3, data: promote }];
    step(&mut node, message(1, RaftKind::Append, |message| message.entries = entries));
    for (voters, believed) in [(&[9][..], false), (&[1, 9], true)] {
        node.ticks += 100;
        bare_step(&mut node, mandate(2, 9, voters));
        bare_step(&mut node, heartbeat(9, 2));
        assert_eq!(node.leader() == Some(9), believed, "{voters:?}");
    }
}

#[test]
fn a_voter_signs_each_vote_that_it_grants_and_no_other() {
    let votes = |out: &[Output]| -> Vec<(bool, Bytes)> {
        let sent = out.iter().filter_map(|output| match output {
            Output::Send { message: PeerMessage::Raft(message), .. } => {
                let answers = matches!(message.kind(), RaftKind::VoteResponse | RaftKind::PreVoteResponse);
                answers.then(|| (message.reject, message.vote.clone()))
            }
            _ => None,
        });
        sent.collect()
    };
    let mut node = engine(2, &VOTERS, &[]);
    let ask = |from: u64, kind| message(from, kind, |message| message.term = 4);
    assert_eq!(votes(&bare_step(&mut node, ask(1, RaftKind::PreVote))), [(false, Bytes::new())]);
    assert_eq!(votes(&bare_step(&mut node, ask(1, RaftKind::Vote))), [(false, signed(4, 1, 2))]);
    assert_eq!(votes(&bare_step(&mut node, ask(3, RaftKind::Vote))), [(true, Bytes::new())], "it has voted");
}

#[test]
fn a_vote_without_the_voters_signature_elects_nobody() {
    for bad in [Bytes::new(), signed(2, 1, 2), signed(1, 3, 2), signed(1, 1, 3)] {
        let mut node = engine(1, &VOTERS, &[]);
        bare_step(&mut node, Input::Campaign);
        bare_step(&mut node, message(2, RaftKind::PreVoteResponse, |_| {}));
        let vote = |from: u64, vote: Bytes| message(from, RaftKind::VoteResponse, |message| message.vote = vote);
        let out = bare_step(&mut node, vote(2, bad));
        assert!(!node.is_leader() && matches!(out[..], [Output::Ignored { from: 2, .. }]), "{out:?}");
        bare_step(&mut node, vote(2, signed(1, 1, 2)));
        assert!(!node.is_leader(), "it is not heard again so soon");
        let out = bare_step(&mut node, vote(3, signed(1, 1, 3)));
        assert!(node.is_leader());
        assert_eq!(shown(&out), [(2, 1, vec![1, 3]), (3, 1, vec![1, 3])]);
    }
}

#[test]
fn a_leader_shows_its_mandate_before_its_first_append_and_again_to_a_member_that_asks() {
    let mut node = engine(1, &VOTERS, &[9]);
    step(&mut node, Input::Campaign);
    step(&mut node, message(2, RaftKind::PreVoteResponse, |_| {}));
    let out = step(&mut node, message(2, RaftKind::VoteResponse, |_| {}));
    for to in [2, 3, 9] {
        let first = out.iter().find(|output| matches!(output, Output::Send { to: receiver, .. } if *receiver == to));
        assert!(matches!(first, Some(Output::Send { message: PeerMessage::Mandate(_), .. })), "{to}: {first:?}");
    }
    assert_eq!(shown(&bare_step(&mut node, ask(9, 1))), [(9, 1, vec![1, 2])]);
    assert_eq!(shown(&bare_step(&mut node, ask(9, 1))), [], "not again at once");
    step(&mut node, message(3, RaftKind::VoteResponse, |_| {}));
    node.ticks += 4;
    assert_eq!(shown(&bare_step(&mut node, ask(9, 1))), [(9, 1, vec![1, 2, 3])], "with a vote that came late");
    for (from, term) in [(8, 1), (3, 2), (3, 0)] {
        assert_eq!(bare_step(&mut node, ask(from, term)), [], "a stranger, or another term");
    }
}

#[test]
fn a_node_that_lacks_the_mandate_of_a_leader_asks_for_it_but_does_not_flood_it() {
    let mut node = engine(2, &VOTERS, &[]);
    assert_eq!(wanted(&bare_step(&mut node, heartbeat(1, 5))), [(1, 5)]);
    assert_eq!(wanted(&bare_step(&mut node, heartbeat(1, 5))), []);
    assert_eq!(wanted(&bare_step(&mut node, heartbeat(3, 6))), [(3, 6)], "another one");
    node.ticks += 4;
    assert_eq!(wanted(&bare_step(&mut node, heartbeat(1, 5))), [(1, 5)]);
    bare_step(&mut node, mandate(5, 1, &[1, 3]));
    bare_step(&mut node, heartbeat(1, 5));
    assert_eq!(node.leader(), Some(1));
}

#[test]
fn nobody_checks_signatures_for_a_node_that_has_just_shown_bad_ones() {
    let mut node = engine(2, &VOTERS, &[]);
    bare_step(&mut node, mandate(5, 1, &[1]));
    bare_step(&mut node, mandate(5, 1, &VOTERS));
    assert!(!node.mandates.is_elected(1, 5));
    bare_step(&mut node, mandate(5, 3, &[1, 3]));
    assert!(node.mandates.is_elected(3, 5), "others are heard");
    node.ticks += 4;
    bare_step(&mut node, mandate(6, 1, &VOTERS));
    assert!(node.mandates.is_elected(1, 6));
}

#[test]
fn the_first_leader_of_a_term_stays_the_only_one_although_a_voter_votes_twice() {
    let mut node = engine(2, &VOTERS, &[]);
    bare_step(&mut node, mandate(5, 1, &[1, 3]));
    bare_step(&mut node, heartbeat(1, 5));
    bare_step(&mut node, mandate(5, 3, &[2, 3]));
    bare_step(&mut node, heartbeat(3, 5));
    assert_eq!(node.leader(), Some(1));
    assert!(node.mandates.is_elected(1, 5) && !node.mandates.is_elected(3, 5));
}

#[test]
fn a_voter_that_signs_votes_for_two_candidates_in_one_term_is_named_with_the_proof() {
    let liars = |out: &[Output]| -> Vec<u64> {
        let named = out.iter().filter_map(|output| match output {
            Output::VotedTwice(found) => Some(found),
            _ => None,
        });
        let proved = named.inspect(|found| {
            let [(first, one), (second, other)] = &found.votes;
            assert_ne!(first, second);
            let vote = |candidate: &u64| signed(found.term, *candidate, found.voter);
            assert_eq!((one, other), (&vote(first), &vote(second)));
        });
        proved.map(|found| found.voter).collect()
    };
    let mut follower = engine(2, &VOTERS, &[]);
    assert_eq!(liars(&bare_step(&mut follower, mandate(5, 1, &[1, 3]))), NOBODY);
    assert_eq!(liars(&bare_step(&mut follower, mandate(5, 3, &[2, 3]))), [3], "it has elected node 1 as well");
    assert_eq!(liars(&bare_step(&mut follower, mandate(6, 3, &[2, 3]))), NOBODY, "in another term it may");

    let mut candidate = engine(1, &[1, 2, 3, 4, 5], &[]);
    bare_step(&mut candidate, Input::Campaign);
    for from in [2, 3] {
        bare_step(&mut candidate, message(from, RaftKind::PreVoteResponse, |_| {}));
    }
    bare_step(&mut candidate, message(2, RaftKind::VoteResponse, |message| message.vote = signed(1, 1, 2)));
    assert_eq!(liars(&bare_step(&mut candidate, mandate(1, 5, &[2, 4, 5]))), [2], "it has voted for this node");
    let late = message(4, RaftKind::VoteResponse, |message| message.vote = signed(1, 1, 4));
    assert_eq!(liars(&bare_step(&mut candidate, late)), [4], "it has elected node 5 as well");
}

#[test]
fn a_vote_that_is_believed_without_its_signature_proves_nothing() {
    let mut node = engine(2, &VOTERS, &[]);
    bare_step(&mut node, mandate(5, 1, &[1, 3]));
    // Node 3 poses as elected by itself, and by node 1 with a vote that nobody has signed.
    let forged = |node: u64| SignedVote { node, signed: Bytes::from_static(b"forged") };
    let shown = Mandate { term: 5, votes: vec![SignedVote { node: 3, signed: signed(5, 3, 3) }, forged(1)] };
    let out = bare_step(&mut node, Input::Message { from: 3, message: PeerMessage::Mandate(shown) });
    assert!(!out.iter().any(|output| matches!(output, Output::VotedTwice(_))));
    node.ticks += 4;
    let shown = Mandate { term: 5, votes: vec![SignedVote { node: 1, signed: signed(5, 3, 1) }, forged(3)] };
    let out = bare_step(&mut node, Input::Message { from: 3, message: PeerMessage::Mandate(shown) });
    let named: Vec<_> = out
        .iter()
        .filter_map(|output| match output {
            Output::VotedTwice(found) => Some(found.voter),
            _ => None,
        })
        .collect();
    assert_eq!(named, [1], "node 3 did not sign its own vote");
}

#[test]
fn a_leader_whose_mandate_does_not_suffice_for_the_voters_of_today_stands_for_election_again_when_asked() {
    let mut node = engine(1, &[1], &[2]);
    step(&mut node, Input::Tick);
    assert!(node.is_leader());
    assert_eq!(shown(&bare_step(&mut node, ask(2, 1))), [(2, 1, vec![1])], "a sole voter has elected itself");
    step(&mut node, message(2, RaftKind::AppendResponse, |message| message.index = 1));
    step(&mut node, Input::ChangeMembership(MembershipChange::new([Change::AddVoter(2)])));
    assert!(node.membership.is_voter(2));
    step(&mut node, message(2, RaftKind::AppendResponse, |message| message.index = 2));
    node.ticks += 4;
    bare_step(&mut node, ask(2, 1));
    assert_eq!((node.is_leader(), node.raw.raft.term), (false, 2));
    let out = step(&mut node, message(2, RaftKind::VoteResponse, |message| message.term = 2));
    assert!(node.is_leader());
    assert_eq!(shown(&out), [(2, 2, vec![1, 2])]);
}

#[test]
fn a_node_whose_voters_have_not_elected_the_leader_asks_its_peers_for_blocks() {
    let mut node = engine(2, &VOTERS, &[]);
    let mut out = Vec::new();
    for _ in 0..300 {
        out.extend(bare_step(&mut node, mandate(5, 1, &[1, 4, 5])));
        out.extend(bare_step(&mut node, Input::Tick));
    }
    assert!(out.iter().any(|output| matches!(output, Output::Behind { .. })));
    assert_ne!(node.leader(), Some(1));
}

#[test]
fn a_node_that_has_lied_is_followed_no_more_and_gets_no_vote_and_its_acknowledgements_count() {
    let mut node = engine(2, &VOTERS, &[]);
    bare_step(&mut node, mandate(5, 1, &[1, 3]));
    bare_step(&mut node, heartbeat(1, 5));
    assert_eq!(node.leader(), Some(1));
    bare_step(&mut node, Input::Exclude([1].into()));
    let last = node.raw.raft.raft_log.last_index();
    let append = |term| {
        let entries = vec![WireEntry { index: 1, term, kind: 1, data: Bytes::new() }];
        message(1, RaftKind::Append, move |message| (message.term, message.entries) = (term, entries))
    };
    let stands = |kind| message(1, kind, |vote| (vote.term, vote.index, vote.log_term) = (9, 9, 8));
    for input in [
        append(5),
        heartbeat(1, 5),
        message(1, RaftKind::TimeoutNow, |message| message.term = 5),
        stands(RaftKind::PreVote),
        stands(RaftKind::Vote),
        mandate(9, 1, &[1, 3]),
        append(9),
    ] {
        let out = bare_step(&mut node, input.clone());
        assert!(matches!(out[..], [Output::Ignored { from: 1, .. }]), "{input:?}: {out:?}");
    }
    assert_eq!((node.raw.raft.term, node.raw.raft.raft_log.last_index()), (5, last));
    // It waits for no leader that it ignores.
    for _ in 0..3 * node.config.election_tick {
        bare_step(&mut node, Input::Tick);
    }
    assert_eq!(node.leader(), None);

    let mut leads = leader(1);
    bare_step(&mut leads, Input::Exclude([2].into()));
    bare_step(&mut leads, Input::Submit { lane: Lane::Data, transaction: vec![0; 10].into() });
    step(&mut leads, message(2, RaftKind::AppendResponse, |message| message.index = 3));
    assert_eq!(leads.raw.raft.raft_log.committed, 3, "what it has on its disk still counts");
}
