//! A leader signs what it sends, and two logs in one term prove that it lies.

use super::chain::{append, entry, follower, hash, responses};
use super::votes::signed_head;
use super::*;
use crate::engine::standing::LOOK_TIMEOUTS;
use crate::interface::DoubleHead;
use crate::message::{LeaderHead, MandateWanted};

fn proofs(out: &[Output]) -> Vec<DoubleHead> {
    let found = out.iter().filter_map(|output| match output {
        Output::TwoHeads(found) => Some((**found).clone()),
        _ => None,
    });
    found.collect()
}

/// The height at which the two logs differ, and the hashes of both heads, as anybody computes them.
fn heads(found: &DoubleHead) -> (u64, [Hash; 2]) {
    let hashes = found.branches.each_ref().map(|branch| {
        let links = (found.height + 1..).zip(&branch.links);
        links.fold(branch.base, |hash, (height, link)| ledger_light::block_hash(height, link, hash))
    });
    for (branch, hash) in found.branches.iter().zip(hashes) {
        let height = found.height + branch.links.len() as u64;
        let head = LogHead { term: found.term, leader: found.leader, height, hash };
        assert_eq!(branch.signature, signed_head(head), "each branch ends at a signed head");
        assert_eq!(branch.vote, signed(found.term, found.leader, found.leader));
    }
    assert_ne!(found.branches[0].base, found.branches[1].base);
    (found.height, hashes)
}

fn changed(input: Input, change: impl FnOnce(&mut RaftMessage)) -> Input {
    let Input::Message { from, message: PeerMessage::Raft(mut message) } = input else { unreachable!("a message") };
    change(&mut message);
    Input::Message { from, message: PeerMessage::Raft(message) }
}

#[test]
fn an_append_without_the_leaders_head_for_this_very_log_is_not_taken() {
    let own = [entry(1, 1, b"a"), entry(2, 1, b"b")];
    let next = || append(1, 1, &own, &[entry(3, 1, b"c")], 1);
    let hash = hash(&[own[0].clone(), own[1].clone(), entry(3, 1, b"c")]);
    let head = LogHead { term: 1, leader: 1, height: 3, hash };
    for (signature, why) in [
        (Bytes::new(), "none"),
        (Bytes::from_static(b"forged"), "a forged one"),
        (signed_head(LogHead { term: 2, ..head }), "of another term"),
        (signed_head(LogHead { height: 2, ..head }), "of another height"),
        (signed_head(LogHead { hash: Hash::ZERO, ..head }), "of another log"),
        (signed_head(LogHead { leader: 3, ..head }), "of another leader"),
    ] {
        let mut node = follower();
        let out = step(&mut node, changed(next(), |message| message.head = signature));
        assert!(out.iter().any(|output| matches!(output, Output::Ignored { from: 1, .. })), "{why}: {out:?}");
        assert_eq!((node.store.last_index(), responses(&out).len()), (2, 0), "{why}");
    }
    let mut node = follower();
    step(&mut node, next());
    assert_eq!(node.store.last_index(), 3);
}

#[test]
fn the_head_of_a_leader_that_only_a_change_in_the_log_makes_a_voter_waits_for_the_record_of_its_certificate() {
    let promote = ledger::members::MembershipChange::new([ledger::members::Change::AddVoter(8)]).to_bytes();
    let mut node = engine(2, &[1, 2, 3], &[]);
    let change = WireEntry { index: 1, term: 1, kind: 3, data: promote };
    step(&mut node, message(1, RaftKind::Append, |message| message.entries = vec![change]));
    step(&mut node, mandate(2, 8, &[1, 3, 8]));
    let leads = |node: &Engine, index: u64, commit: u64| {
        let (hash, log_term) = (node.chain.hash(index).unwrap(), node.store.term(index).unwrap());
        message(8, RaftKind::Append, move |message| {
            (message.term, message.log_term, message.index, message.commit) = (2, log_term, index, commit);
            (message.hash, message.entries) = (hash.0.to_vec().into(), vec![entry(index + 1, 2, b"a")]);
        })
    };
    let first = leads(&node, 1, 1);
    bare_step(&mut node, first);
    assert_eq!((node.store.last_index(), node.membership.contains(8)), (2, true));
    let next = leads(&node, 2, 1);
    bare_step(&mut node, next);
    assert_eq!(node.store.last_index(), 2, "it is a member now, so its head counts");
}

#[test]
fn a_round_is_signed_once_and_a_head_that_was_signed_before_is_not_signed_again() {
    let mut node = leader(1);
    step(&mut node, message(3, RaftKind::AppendResponse, |message| message.index = 2));
    let signed_heads = |out: &[Output]| -> Vec<Bytes> {
        let appends = out.iter().filter_map(|output| match output {
            Output::Send { message: PeerMessage::Raft(message), .. } if message.kind() == RaftKind::Append => {
                Some(message.head.clone())
            }
            _ => None,
        });
        appends.collect()
    };
    let before = node.heads.signed_so_far();
    let out = step(&mut node, Input::Submit { lane: Lane::Data, transaction: vec![1].into() });
    let head = signed_head(LogHead { term: 1, leader: 1, height: 3, hash: node.chain.hash(3).unwrap() });
    assert_eq!(signed_heads(&out), [head.clone(), head.clone()], "to both followers");
    assert_eq!(node.heads.signed_so_far(), before + 1);
    // The commit is told with the same head.
    let out = step(&mut node, message(2, RaftKind::AppendResponse, |message| message.index = 3));
    assert!(signed_heads(&out).iter().all(|signature| *signature == head) && !signed_heads(&out).is_empty());
    assert_eq!(node.heads.signed_so_far(), before + 1);
}

#[test]
fn a_leader_that_appends_two_logs_in_one_term_is_proved_a_liar() {
    let (one, two) = (entry(1, 1, b"a"), entry(2, 1, b"B"));
    // Its entries differ from those that it sent before.
    let out = step(&mut follower(), append(1, 1, std::slice::from_ref(&one), &[two.clone(), entry(3, 1, b"c")], 0));
    let own = hash(&[one.clone(), entry(2, 1, b"b")]);
    let other = hash(&[one.clone(), two.clone(), entry(3, 1, b"c")]);
    let found: Vec<_> = proofs(&out).iter().map(heads).collect();
    assert_eq!(found, [(2, [own, other])]);
    // So does the entry before.
    let out = step(&mut follower(), append(1, 1, &[one.clone(), two.clone()], &[entry(3, 1, b"c")], 0));
    assert_eq!(proofs(&out).iter().map(heads).collect::<Vec<_>>(), [(2, [own, other])]);
    // Without its signature it is no proof, and not taken either.
    let unsigned = append(1, 1, &[one.clone(), two.clone()], &[entry(3, 1, b"c")], 0);
    let out = step(&mut follower(), changed(unsigned, |message| message.head = Bytes::from_static(b"forged")));
    assert_eq!(proofs(&out), []);
    // A leader of a later term has not signed what this node has.
    let out = step(&mut follower(), append(3, 2, &[one, two], &[entry(3, 2, b"c")], 0));
    assert_eq!(proofs(&out), []);
}

/// Node 3 shows a head of node 1.
fn shown(term: u64, log: &[WireEntry]) -> LeaderHead {
    let head = LogHead { term, leader: 1, height: log.len() as u64, hash: hash(log) };
    LeaderHead {
        term,
        leader: 1,
        height: head.height,
        hash: head.hash.0.to_vec().into(),
        signature: signed_head(head),
        vote: signed(term, 1, 1),
    }
}

fn show(node: &mut Engine, shown: LeaderHead) -> Vec<Output> {
    step(node, Input::Message { from: 3, message: PeerMessage::Head(shown) })
}

#[test]
fn two_followers_of_a_leader_with_two_faces_meet_the_proof() {
    let (a, b) = (entry(1, 1, b"a"), entry(2, 1, b"b"));
    let fork = [entry(1, 1, b"A")];
    let out = show(&mut follower(), shown(1, &fork));
    let found: Vec<_> = proofs(&out).iter().map(heads).collect();
    assert_eq!(found, [(1, [hash(&[a.clone(), b.clone()]), hash(&fork)])], "although the heights of the heads differ");

    for (harmless, why) in [
        (shown(1, std::slice::from_ref(&a)), "the same log"),
        (
            shown(1, &[entry(1, 1, b"A"), b.clone(), entry(3, 1, b"c")]),
            "the other one finds out with the head of this node",
        ),
        (shown(2, &fork), "another term"),
        (LeaderHead { signature: Bytes::from_static(b"forged"), ..shown(1, &fork) }, "nobody has signed it"),
        (LeaderHead { vote: signed(1, 3, 3), ..shown(1, &fork) }, "a certificate of another node"),
        (LeaderHead { leader: 3, ..shown(1, &fork) }, "another leader"),
        (LeaderHead { hash: Bytes::new(), ..shown(1, &fork) }, "no hash"),
    ] {
        assert_eq!(proofs(&show(&mut follower(), harmless)), [], "{why}");
    }
    // What another leader has superseded since proves nothing.
    let mut node = follower();
    step(&mut node, append(3, 2, std::slice::from_ref(&a), &[entry(2, 2, b"B")], 1));
    assert_eq!(proofs(&show(&mut node, shown(1, &[a, entry(2, 1, b"B")]))), []);
}

#[test]
fn a_voter_shows_the_newest_head_to_the_other_voters_once_a_second_and_when_another_node_leads() {
    let told = |out: &[Output]| -> Vec<(u64, LeaderHead)> {
        let sent = out.iter().filter_map(|output| match output {
            Output::Send { to, message: PeerMessage::Head(head) } => Some((*to, head.clone())),
            _ => None,
        });
        sent.collect()
    };
    let newest = shown(1, &[entry(1, 1, b"a"), entry(2, 1, b"b")]);
    let mut node = follower();
    assert_eq!(told(&step(&mut node, Input::Tick)), [(3, newest.clone())], "a new leader");
    let second = 5 * node.config.election_tick;
    let mut later = Vec::new();
    for _ in 0..second {
        step(&mut node, message(1, RaftKind::Heartbeat, |_| {}));
        later.extend(told(&step(&mut node, Input::Tick)));
    }
    assert_eq!(later, [(3, newest.clone())]);
    step(&mut node, message(3, RaftKind::Heartbeat, |message| message.term = 2));
    assert_eq!(told(&step(&mut node, Input::Tick)), [(3, newest)], "that of the leader before");
    let mut learner = engine(9, &[1, 2, 3], &[9]);
    step(&mut learner, append(1, 1, &[], &[entry(1, 1, b"a")], 1));
    let shown: Vec<_> = (0..2 * second).flat_map(|_| told(&step(&mut learner, Input::Tick))).collect();
    assert_eq!(shown, []);
}

#[test]
fn a_node_that_lacks_the_certificate_of_its_leader_asks_for_the_mandate_and_takes_the_renewed_one() {
    let mut node = engine(2, &[1, 2, 3], &[]);
    let vote = |vote: Bytes| {
        let votes = [(1, vote), (3, signed(1, 1, 3))].map(|(node, signed)| crate::message::SignedVote { node, signed });
        let message = PeerMessage::Mandate(crate::message::Mandate { term: 1, votes: votes.to_vec() });
        Input::Message { from: 1, message }
    };
    // The vote of the leader for itself is believed, as its connection names it; its certificate is of no use.
    bare_step(&mut node, vote(Bytes::from_static(b"unknown")));
    let out = bare_step(&mut node, append(1, 1, &[], &[entry(1, 1, b"a")], 0));
    let asks = Output::Send { to: 1, message: PeerMessage::MandateWanted(MandateWanted { term: 1 }) };
    assert!(out.contains(&asks), "{out:?}");
    assert_eq!(node.store.last_index(), 0);
    bare_step(&mut node, vote(signed(1, 1, 1)));
    bare_step(&mut node, append(1, 1, &[], &[entry(1, 1, b"a")], 0));
    assert_eq!(node.store.last_index(), 1);
}

#[test]
fn a_node_that_cannot_check_the_heads_of_its_leader_asks_its_peers_for_blocks() {
    let mut node = follower();
    let mut asked = 0;
    for _ in 0..2 * LOOK_TIMEOUTS * node.config.election_tick {
        let unchecked = append(1, 1, &[entry(1, 1, b"a"), entry(2, 1, b"b")], &[entry(3, 1, b"c")], 0);
        step(&mut node, changed(unchecked, |message| message.head = Bytes::from_static(b"after a recovery")));
        step(&mut node, message(1, RaftKind::Heartbeat, |_| {}));
        let out = step(&mut node, Input::Tick);
        asked += out.iter().filter(|output| matches!(output, Output::Behind { from: 2, .. })).count();
        assert_eq!(node.leader(), Some(1), "its mandate was checked");
    }
    assert!((1..=2).contains(&asked), "{asked}");
    step(&mut node, append(1, 1, &[entry(1, 1, b"a"), entry(2, 1, b"b")], &[entry(3, 1, b"c")], 0));
    for _ in 0..2 * LOOK_TIMEOUTS * node.config.election_tick {
        step(&mut node, message(1, RaftKind::Heartbeat, |_| {}));
        let out = step(&mut node, Input::Tick);
        assert!(!out.iter().any(|output| matches!(output, Output::Behind { .. })), "it takes heads again");
    }
}

#[test]
fn a_leader_whose_certificate_is_renewed_shows_its_mandate_before_the_next_append() {
    let mut node = leader(1);
    let shows = |out: &[Output]| {
        let place = |wanted: fn(&PeerMessage) -> bool| {
            out.iter().position(|output| matches!(output, Output::Send { to: 2, message } if wanted(message)))
        };
        let append = place(|message| message.brings_entries()).unwrap();
        place(|message| matches!(message, PeerMessage::Mandate(_))).is_some_and(|mandate| mandate < append)
    };
    let submit = || Input::Submit { lane: Lane::Data, transaction: vec![1].into() };
    assert!(!shows(&step(&mut node, submit())));
    node.heads.pretend_certificate(1, Bytes::from_static(b"the one before"));
    assert!(shows(&step(&mut node, submit())));
    assert!(!shows(&step(&mut node, submit())));
}
