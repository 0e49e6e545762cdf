//! The leadership is handed over with the leader's signed word only.

use super::votes::signed_handover;
use super::*;

const TRANSFER: Bytes = Bytes::from_static(raft::CAMPAIGN_TRANSFER);

/// Node 2 of three follows node 1 in term 1.
fn follower() -> Engine {
    let mut node = engine(2, &[1, 2, 3], &[]);
    step(&mut node, message(1, RaftKind::Heartbeat, |_| {}));
    node
}

/// Node 3 asks for a vote in term 2 in spite of the lease.
fn asks(kind: RaftKind, word: Bytes) -> Input {
    message(3, kind, move |message| {
        (message.term, message.index, message.log_term) = (2, 99, 1);
        (message.context, message.transfer) = (TRANSFER, word);
    })
}

fn word(term: u64, leader: u64, to: u64) -> Bytes {
    signed_handover(Handover { term, leader, to })
}

#[test]
fn while_the_leader_lives_a_transfer_is_honoured_with_its_word_for_this_term_and_voter_only() {
    for (signed, why) in [
        (Bytes::new(), "no word"),
        (word(1, 3, 3), "its own word"),
        (word(1, 1, 2), "the word for another voter"),
        (word(2, 1, 3), "the word of another term"),
        (Bytes::from_static(b"forged"), "a forged word"),
    ] {
        let mut node = follower();
        step(&mut node, asks(RaftKind::Vote, signed));
        assert_eq!((node.raw.raft.term, node.leader()), (1, Some(1)), "{why}");
    }
    let mut node = follower();
    step(&mut node, asks(RaftKind::Vote, word(1, 1, 3)));
    assert_eq!((node.raw.raft.term, node.raw.raft.vote), (2, 3));
}

#[test]
fn a_request_without_the_word_is_one_like_any_other_when_no_leader_lives() {
    let mut node = follower();
    for _ in 0..node.config.election_tick {
        step(&mut node, Input::Tick);
    }
    step(&mut node, asks(RaftKind::Vote, Bytes::new()));
    assert_eq!((node.raw.raft.term, node.raw.raft.vote), (2, 3));
}

#[test]
fn a_pre_vote_never_passes_the_lease() {
    for signed in [Bytes::new(), word(1, 1, 3)] {
        let out = step(&mut follower(), asks(RaftKind::PreVote, signed));
        assert_eq!(sent(&out), []);
    }
    assert_eq!(sent(&step(&mut follower(), message(3, RaftKind::PreVote, |message| message.term = 2))), []);
}

#[test]
fn nobody_knocks_for_a_vote_with_forged_words_without_a_pause() {
    let mut node = follower();
    step(&mut node, asks(RaftKind::Vote, Bytes::from_static(b"forged")));
    step(&mut node, asks(RaftKind::Vote, word(1, 1, 3)));
    assert_eq!(node.raw.raft.term, 1, "it is not checked again so soon");
    node.ticks += node.config.heartbeat_tick as u64;
    step(&mut node, asks(RaftKind::Vote, word(1, 1, 3)));
    assert_eq!(node.raw.raft.term, 2);
}

#[test]
fn a_leader_signs_that_it_hands_over_and_the_transferee_shows_that_to_the_voters() {
    let mut node = leader(1);
    let out = step(&mut node, Input::TransferLeadership { to: 2 });
    let found = out.iter().find_map(|output| match output {
        Output::Send { to: 2, message: PeerMessage::Raft(message) } if message.kind() == RaftKind::TimeoutNow => {
            Some(message.transfer.clone())
        }
        _ => None,
    });
    assert_eq!(found, Some(word(1, 1, 2)));

    let shown = |signed: Bytes| {
        let mut node = follower();
        let out = step(&mut node, message(1, RaftKind::TimeoutNow, move |message| message.transfer = signed));
        let requests = out.iter().filter_map(|output| match output {
            Output::Send { message: PeerMessage::Raft(message), .. } if message.kind() == RaftKind::Vote => {
                Some((message.context.clone(), message.transfer.clone()))
            }
            _ => None,
        });
        requests.collect::<Vec<_>>()
    };
    assert_eq!(shown(word(1, 1, 2)), vec![(TRANSFER, word(1, 1, 2)); 2]);
    for useless in [Bytes::new(), word(1, 1, 3), Bytes::from_static(b"forged")] {
        assert_eq!(shown(useless), [], "it could not show it to anybody");
    }
}
