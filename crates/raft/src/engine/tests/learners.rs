//! Learners: what a leader sends them when, and what they hand out before their own disk has it.

use super::*;

/// Appends to node 9 in these outputs: the entries and the commit that they bring.
fn appends_to_learner(out: &[Output]) -> Vec<(usize, u64)> {
    out.iter()
        .filter_map(|output| match output {
            Output::Send { to: 9, message: PeerMessage::Raft(message) } => {
                (message.kind == i32::from(RaftKind::Append)).then_some((message.entries.len(), message.commit))
            }
            _ => None,
        })
        .collect()
}

/// Node 1 leads alone; learner 9 holds the empty block that opens its term.
fn leader_with_learner() -> Engine {
    let mut engine = engine(1, &[1], &[9]);
    step(&mut engine, Input::Tick);
    assert!(engine.is_leader());
    step(&mut engine, message(9, RaftKind::AppendResponse, |message| message.index = 1));
    assert_eq!(progress(&engine, 9), (1, 2));
    engine
}

#[test]
fn a_learner_gets_a_block_with_its_commit_in_one_message() {
    let mut engine = leader_with_learner();
    let mut out = Vec::new();
    for transaction in ["a", "b"] {
        engine.step(1000, Input::Submit { lane: Lane::Data, transaction: transaction.into() }, &mut out);
    }
    assert_eq!(appends_to_learner(&out), [], "nothing of it is committed");
    engine.store.flush().unwrap();
    let ready = out.iter().filter_map(|output| match output {
        Output::Flush { ready } => Some(*ready),
        _ => None,
    });
    let ready = ready.last().unwrap();
    out.clear();
    engine.step(1000, Input::Persisted { ready }, &mut out);
    let last = engine.raw.raft.raft_log.last_index();
    assert_eq!(appends_to_learner(&out), [(last as usize - 1, last)]);
    assert!(engine.held.is_empty());
}

#[test]
fn what_is_held_back_goes_to_a_learner_that_becomes_a_voter_and_is_forgotten_by_a_leader_that_falls() {
    let mut engine = leader_with_learner();
    let submit = || Input::Submit { lane: Lane::Data, transaction: "a".into() };
    engine.step(1000, submit(), &mut Vec::new());
    assert_eq!(engine.held.len(), 1);
    engine.membership = Membership::new([1, 9], []);
    let mut out = Vec::new();
    for _ in 0..10 {
        engine.step(1000, Input::Tick, &mut out);
    }
    assert_eq!(appends_to_learner(&out), [(1, 1)], "with the next heartbeat at the latest");

    engine.membership = Membership::new([1], [9]);
    engine.step(1000, submit(), &mut Vec::new());
    engine.store.flush().unwrap();
    engine.raw.raft.become_follower(7, 0);
    engine.step(1000, Input::Tick, &mut Vec::new());
    assert!(engine.held.is_empty());
}

#[test]
fn a_learner_hands_out_what_is_committed_before_its_own_disk_has_it() {
    let commits = |engine: &mut Engine| {
        let entries = (1..=2).map(|index| WireEntry { index, term: 1, kind: 1, data: Bytes::new() }).collect();
        let append = message(1, RaftKind::Append, |message| (message.entries, message.commit) = (entries, 2));
        let mut out = Vec::new();
        engine.step(1000, mandate(1, 1, &[1, 2]), &mut out);
        let append = honest(engine, append);
        engine.step(1000, append, &mut out);
        engine.step(1000, Input::Applied { height: 2, at: 1000 }, &mut out);
        assert_eq!(engine.store.durable_index(), 0);
        out.iter().any(|output| matches!(output, Output::Commit(entries) if entries.len() == 2))
    };
    let (mut learner, mut voter) = (engine(9, &[1, 2], &[9]), engine(2, &[1, 2], &[9]));
    assert!(commits(&mut learner));
    assert!(!commits(&mut voter), "a voter acknowledges to others what it has on disk, and knows no more itself");
    // The crate learns of it when the disk has it.
    assert_eq!((learner.applied, learner.raw.raft.raft_log.applied), (2, 0));
    learner.store.flush().unwrap();
    let ready = learner.pending.back().unwrap().number;
    step(&mut learner, Input::Persisted { ready });
    assert_eq!(learner.raw.raft.raft_log.applied, 2);
}
