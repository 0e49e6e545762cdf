//! The inside of the engine: progress of peers, and the decisions that the crate would have made.

mod acknowledged;
mod bounds;
mod chain;
mod doubt;
mod handover;
mod heads;
mod learners;
mod mandate;
mod promises;
mod standing;
mod time;
mod votes;

use super::*;
use crate::Lane;
use crate::message::{RaftKind, RaftMessage, WireEntry};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_storage::block_store::Options;
use ledger_storage::disk::SimDisk;
use votes::{Genesis, Names, honest, mandate, signed, step};

fn engine(id: u64, voters: &[u64], learners: &[u64]) -> Engine {
    let disk = SimDisk::new(id);
    let mut options = Options::new([7; 32], || 1);
    options.segment_bytes = 1 << 16;
    let (store, _) = BlockStore::open(Arc::new(disk), options).unwrap();
    let members = Membership::new(voters.iter().copied(), learners.iter().copied());
    Engine::new(EngineConfig::new(id, members, id), Arc::new(store), Arc::new(Genesis), Arc::new(Names(id))).unwrap()
}

/// Steps, with a disk that is done at once and an executor that keeps up.
fn bare_step(engine: &mut Engine, input: Input) -> Vec<Output> {
    let (mut all, mut inputs) = (Vec::new(), vec![input]);
    while let Some(input) = inputs.pop() {
        let mut out = Vec::new();
        engine.step(1000, input, &mut out);
        for output in &out {
            match output {
                Output::Flush { ready } => {
                    engine.store.flush().unwrap();
                    inputs.push(Input::Persisted { ready: *ready });
                }
                Output::Commit(entries) => {
                    inputs.push(Input::Applied { height: entries.last().unwrap().index, at: 1000 });
                }
                _ => {}
            }
        }
        all.extend(out);
    }
    all
}

fn message(from: u64, kind: RaftKind, change: impl FnOnce(&mut RaftMessage)) -> Input {
    let mut message = RaftMessage { kind: kind.into(), term: 1, ..RaftMessage::default() };
    change(&mut message);
    Input::Message { from, message: PeerMessage::Raft(message) }
}

/// Node 1 of three leads in term 1 with `blocks` blocks, all of which node 2 holds.
fn leader(blocks: u64) -> Engine {
    let mut engine = engine(1, &[1, 2, 3], &[]);
    step(&mut engine, Input::Campaign);
    step(&mut engine, message(2, RaftKind::PreVoteResponse, |_| {}));
    step(&mut engine, message(2, RaftKind::VoteResponse, |_| {}));
    assert!(engine.is_leader());
    step(&mut engine, message(2, RaftKind::AppendResponse, |message| message.index = 1));
    for nth in 0..blocks {
        let transaction = vec![0; 10].into();
        step(&mut engine, Input::Submit { lane: Lane::Data, transaction });
        step(&mut engine, message(2, RaftKind::AppendResponse, |message| message.index = 2 + nth));
    }
    assert_eq!(engine.raw.raft.raft_log.committed, 1 + blocks);
    engine
}

fn progress(engine: &Engine, node: u64) -> (u64, u64) {
    let progress = engine.raw.raft.prs().get(node).unwrap();
    (progress.matched, progress.next_idx)
}

#[test]
fn a_leader_without_other_members_needs_no_ticks_and_they_change_nothing() {
    let mut alone = engine(1, &[1], &[]);
    assert!(alone.needs_ticks(), "it does not lead yet");
    step(&mut alone, Input::Tick);
    assert!(!alone.needs_ticks());
    let status = alone.status();
    for _ in 0..1000 {
        assert_eq!(step(&mut alone, Input::Tick), []);
    }
    assert_eq!(alone.status(), status);

    let mut followed = engine(1, &[1], &[2]);
    step(&mut followed, Input::Tick);
    assert!(followed.is_leader() && followed.needs_ticks(), "a learner waits for heartbeats");
    assert!(leader(0).needs_ticks() && engine(2, &[1, 2], &[]).needs_ticks());
}

/// A refusal of the probe that starts at `index`, which points back to `hint`.
fn refusal(index: u64, hint: u64) -> RaftMessage {
    RaftMessage {
        kind: RaftKind::AppendResponse.into(),
        term: 1,
        index,
        reject: true,
        reject_hint: hint,
        log_term: u64::from(hint > 0),
        ..RaftMessage::default()
    }
}

/// raft-rs #557 / #555: node 2 held everything, became unreachable (so it is probed from `matched`), and a refusal
/// from before comes late.
#[test]
fn a_late_refusal_never_makes_a_probe_start_below_what_the_peer_holds() {
    for (index, hint) in [(6, 2), (6, 0), (6, 5), (7, 2), (7, 0), (7, 1)] {
        let mut engine = leader(5);
        assert_eq!(progress(&engine, 2), (6, 7));
        step(&mut engine, Input::Unreachable { peer: 2 });
        if index == 7 {
            // A block that node 2 was sent before it was probed, so that a probe may start above `matched`.
            engine.raw.raft.mut_prs().get_mut(2).unwrap().next_idx = 8;
            step(&mut engine, Input::Submit { lane: Lane::Data, transaction: vec![1].into() });
        }
        let message = PeerMessage::Raft(refusal(index, hint));
        step(&mut engine, Input::Message { from: 2, message });
        let (matched, next) = progress(&engine, 2);
        assert!(next > matched, "refusal of {index} with hint {hint}: matched {matched}, next {next}");
    }
}

#[test]
fn less_is_ordered_ahead_while_execution_takes_long() {
    let mut engine = engine(1, &[1], &[]);
    step(&mut engine, Input::Tick);
    assert!(engine.is_leader());
    // Orders and executes a transaction; what its block leaves to the next one.
    let mut room_after = |took: u64| {
        let mut inputs = vec![Input::Submit { lane: Lane::Data, transaction: Bytes::from_static(b"drive") }];
        while let Some(input) = inputs.pop() {
            let mut out = Vec::new();
            engine.step(1000, input, &mut out);
            inputs.extend(out.iter().filter_map(|output| match output {
                Output::Flush { ready } => {
                    engine.store.flush().unwrap();
                    Some(Input::Persisted { ready: *ready })
                }
                Output::Commit(entries) => {
                    Some(Input::Applied { height: entries.last().unwrap().index, at: 1000 + took })
                }
                _ => None,
            }));
        }
        engine.room_ahead()
    };
    let usual = room_after(100);
    let (slow, slower) = (room_after(5000), room_after(5000));
    assert!(slow < usual && slower < slow, "{usual}, {slow}, {slower}");
    assert!(room_after(100) > slower);
}

#[test]
fn without_the_guard_the_crate_has_the_fault_of_557() {
    let mut engine = leader(5);
    step(&mut engine, Input::Unreachable { peer: 2 });
    let message = refusal(6, 2).into_raft(2, 1).unwrap();
    engine.raw.step(message).unwrap();
    let (matched, next) = progress(&engine, 2);
    assert!(next <= matched, "the crate is repaired: the guard can go");
}

#[test]
fn a_true_refusal_still_leads_the_probe_back() {
    let mut engine = leader(5);
    // Node 3 has said nothing yet and holds nothing; it was probed from index 0 at the election, and again here.
    engine.raw.raft.mut_prs().get_mut(3).unwrap().next_idx = 5;
    step(&mut engine, Input::Message { from: 3, message: PeerMessage::Raft(refusal(4, 1)) });
    assert_eq!(progress(&engine, 3), (0, 2));
}

#[test]
fn hostile_messages_change_nothing_and_never_panic() {
    let huge = u64::MAX;
    let entry = |index| WireEntry { index, term: 1, kind: 1, data: Bytes::new() };
    let hostile = [
        message(2, RaftKind::Heartbeat, |message| message.commit = huge),
        message(2, RaftKind::Append, |message| {
            message.index = 100;
            message.entries = vec![entry(101)];
        }),
        message(2, RaftKind::Append, |message| message.commit = huge),
        message(2, RaftKind::AppendResponse, |message| message.index = huge),
        message(2, RaftKind::AppendResponse, |message| message.index = 100),
        message(2, RaftKind::AppendResponse, |message| {
            message.reject = true;
            message.reject_hint = huge;
            message.index = 6;
        }),
        message(2, RaftKind::ReadIndex, |message| message.term = 0),
        message(2, RaftKind::ReadIndexResponse, |message| message.index = huge),
        message(1, RaftKind::Append, |message| message.index = 6),
        message(0, RaftKind::Heartbeat, |_| {}),
        message(9, RaftKind::AppendResponse, |message| message.index = 6),
        message(2, RaftKind::Vote, |message| {
            message.commit = huge;
            message.commit_term = 1;
        }),
        message(2, RaftKind::TimeoutNow, |_| {}),
    ];
    for input in hostile {
        for mut engine in [leader(5), follower()] {
            let before = engine.raw.raft.raft_log.committed;
            step(&mut engine, input.clone());
            for _ in 0..100 {
                step(&mut engine, Input::Tick);
            }
            assert_eq!(engine.raw.raft.raft_log.committed, before, "{input:?}");
            assert!(engine.store.last_index() < 50, "{input:?}");
        }
    }
}

#[test]
fn an_ignored_message_is_told_with_its_sender_and_the_reason() {
    let out = step(&mut leader(1), message(2, RaftKind::AppendResponse, |message| message.index = 1000));
    assert_eq!(out, [Output::Ignored { from: 2, reason: "it acknowledges entries that do not exist" }]);
}

/// Node 1 follows node 2 and holds one committed entry.
fn follower() -> Engine {
    let mut engine = engine(1, &[1, 2, 3], &[]);
    step(
        &mut engine,
        message(2, RaftKind::Append, |message| {
            message.entries = vec![WireEntry { index: 1, term: 1, kind: 1, data: Bytes::new() }];
            message.commit = 1;
        }),
    );
    assert_eq!((engine.emitted, engine.applied), (1, 1));
    engine
}

#[test]
fn nothing_that_promises_goes_out_before_it_is_on_disk() {
    let mut engine = engine(1, &[1, 2, 3], &[]);
    let mut out = Vec::new();
    let vote = message(2, RaftKind::Vote, |message| message.term = 3);
    engine.step(0, vote, &mut out);
    let [Output::Role(_), Output::Flush { ready }] = out[..] else { panic!("found {out:?}") };
    out.clear();
    engine.step(0, mandate(3, 2, &[1, 2]), &mut out);
    let append = message(2, RaftKind::Append, |message| {
        message.term = 3;
        message.entries = vec![WireEntry { index: 1, term: 3, kind: 1, data: Bytes::new() }];
    });
    let append = honest(&engine, append);
    engine.step(0, append.clone(), &mut out);
    let flushed: Vec<_> = out.iter().filter(|output| matches!(output, Output::Flush { .. })).cloned().collect();
    assert_eq!(flushed.len(), 1, "found {out:?}");
    // The same once more needs no write of its own, but what it acknowledges is still not on disk.
    engine.step(0, append, &mut out);
    assert!(!out.iter().any(|output| matches!(output, Output::Send { .. })), "found {out:?}");
    out.clear();
    engine.store.flush().unwrap();
    engine.step(0, Input::Persisted { ready }, &mut out);
    assert_eq!(sent(&out), [RaftKind::VoteResponse]);
    out.clear();
    engine.step(0, Input::Persisted { ready: ready + 1 }, &mut out);
    assert_eq!(sent(&out), [RaftKind::AppendResponse], "said once");
}

fn sent(out: &[Output]) -> Vec<RaftKind> {
    out.iter()
        .filter_map(|output| match output {
            Output::Send { message: PeerMessage::Raft(message), .. } => RaftKind::try_from(message.kind).ok(),
            _ => None,
        })
        .collect()
}

#[test]
fn a_leader_sends_before_its_own_disk_is_done_and_does_not_count_itself_until_then() {
    let mut engine = leader(0);
    let mut out = Vec::new();
    engine.step(0, Input::Submit { lane: Lane::Data, transaction: vec![1].into() }, &mut out);
    assert!(sent(&out).contains(&RaftKind::Append), "found {out:?}");
    let Some(Output::Flush { ready }) = out.last() else { panic!("found {out:?}") };
    let ready = *ready;
    assert_eq!(engine.raw.raft.prs().get(1).unwrap().matched, 1);
    // One other of three is no majority without the leader itself.
    let acknowledgement = honest(&engine, message(3, RaftKind::AppendResponse, |message| message.index = 2));
    engine.step(0, acknowledgement, &mut out);
    assert_eq!(engine.raw.raft.raft_log.committed, 1);
    engine.store.flush().unwrap();
    engine.step(0, Input::Persisted { ready }, &mut out);
    assert_eq!(engine.raw.raft.raft_log.committed, 2);
}

#[test]
fn a_leader_alone_counts_its_entry_only_when_it_is_on_disk() {
    let mut engine = engine(1, &[1], &[]);
    let mut out = Vec::new();
    engine.step(0, Input::Tick, &mut out);
    assert!(engine.is_leader());
    assert!(!out.iter().any(|output| matches!(output, Output::Commit(_))), "found {out:?}");
    let Some(Output::Flush { ready }) = out.last() else { panic!("found {out:?}") };
    let ready = *ready;
    out.clear();
    engine.store.flush().unwrap();
    engine.step(0, Input::Persisted { ready }, &mut out);
    assert!(matches!(&out[..], [Output::Commit(entries)] if entries.len() == 1), "found {out:?}");
}

#[test]
fn a_commit_reaches_a_learner_at_once_although_nothing_follows() {
    let mut engine = engine(1, &[1], &[9]);
    step(&mut engine, Input::Tick);
    step(&mut engine, message(9, RaftKind::AppendResponse, |message| message.index = 1));
    let mut out = Vec::new();
    engine.step(0, Input::Submit { lane: Lane::Data, transaction: vec![1].into() }, &mut out);
    let Some(Output::Flush { ready }) = out.last() else { panic!("found {out:?}") };
    let ready = *ready;
    out.clear();
    engine.store.flush().unwrap();
    engine.step(0, Input::Persisted { ready }, &mut out);
    let commit = out.iter().find_map(|output| match output {
        Output::Send { to: 9, message: PeerMessage::Raft(message) } => Some(message.commit),
        _ => None,
    });
    assert_eq!(commit, Some(2), "found {out:?}");
}

#[test]
fn timeouts_come_from_the_seed_alone() {
    let run = |seed: u64| {
        let mut engine = engine(1, &[1, 2, 3], &[]);
        engine.config.seed = seed;
        engine.draw_timeout();
        let mut timeouts = Vec::new();
        for _ in 0..400 {
            step(&mut engine, Input::Tick);
            timeouts.push(engine.raw.raft.randomized_election_timeout());
        }
        timeouts
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5), run(6));
    let mut drawn = run(5);
    drawn.dedup();
    assert!(drawn.len() > 5, "found {drawn:?}");
}

#[test]
fn a_node_far_behind_does_not_stand_for_election_but_votes() {
    let mut engine = follower();
    (engine.applied, engine.promised) = (0, Promised::NONE);
    engine.raw.raft.raft_log.committed = 1;
    let due = |engine: &Engine| engine.may_campaign();
    assert!(due(&engine), "one block is not far");
    // Entries that are not on disk yet: winning alone with those would break the crate's assumption.
    engine.raw.raft.raft_log.persisted = 0;
    assert!(!due(&engine));
    for _ in 0..200 {
        let mut out = Vec::new();
        engine.step(0, Input::Tick, &mut out);
        assert!(sent(&out).is_empty(), "found {out:?}");
    }
    let out = step(
        &mut engine,
        message(3, RaftKind::PreVote, |message| {
            message.term = 2;
            message.index = 1;
            message.log_term = 1;
        }),
    );
    assert_eq!(sent(&out), [RaftKind::PreVoteResponse]);
}

#[test]
fn a_read_of_an_earlier_start_is_not_answered() {
    let engine = engine(1, &[1], &[]);
    assert_eq!(engine.read_context(&engine.read_name(77)), Some(77));
    let mut other = EngineConfig::new(1, Membership::new([1], []), 99);
    other.seed = 99;
    let mut later = engine;
    let name = later.read_name(77);
    later.config = other;
    assert_eq!(later.read_context(&name), None);
    assert_eq!(later.read_context(b"short"), None);
}

fn read_ready(out: &[Output]) -> Vec<u64> {
    out.iter()
        .filter_map(|output| match output {
            Output::ReadReady { context, .. } => Some(*context),
            _ => None,
        })
        .collect()
}

fn heartbeat_contexts(out: &[Output]) -> Vec<Bytes> {
    out.iter()
        .filter_map(|output| match output {
            Output::Send { to: 3, message: PeerMessage::Raft(message) }
                if message.kind == i32::from(RaftKind::Heartbeat) =>
            {
                Some(message.context.clone())
            }
            _ => None,
        })
        .collect()
}

/// etcd #20418. The leader is deposed without knowing; messages on their way to it are old.
#[test]
fn a_repeated_question_and_late_answers_confirm_no_read() {
    let mut engine = leader(3);
    let question = || {
        message(2, RaftKind::ReadIndex, |message| {
            message.term = 0;
            message.context = vec![7; 24].into();
        })
    };
    let out = step(&mut engine, question());
    let asked = heartbeat_contexts(&out);
    let [context] = &asked[..] else { panic!("found {asked:?}") };
    let answer = message(3, RaftKind::HeartbeatResponse, |message| message.context = context.clone());
    let out = step(&mut engine, answer.clone());
    assert!(sent(&out).contains(&RaftKind::ReadIndexResponse));
    // An own read, then the question once more, then the answer to the first one once more.
    let mut out = step(&mut engine, Input::ReadIndex { context: 99 });
    out.extend(step(&mut engine, question()));
    let named = heartbeat_contexts(&out);
    assert!(!named.contains(context), "found {named:?}");
    let out = step(&mut engine, answer);
    assert!(read_ready(&out).is_empty() && !sent(&out).contains(&RaftKind::ReadIndexResponse), "found {out:?}");
    // A true answer confirms.
    let last = named.last().unwrap().clone();
    let now = message(3, RaftKind::HeartbeatResponse, |message| message.context = last);
    let out = step(&mut engine, now);
    assert_eq!(read_ready(&out), [99]);
}

#[test]
fn without_names_of_the_leaders_own_the_crate_answers_from_late_acknowledgements() {
    let mut engine = leader(3);
    let raw = |engine: &mut Engine, kind, name: &[u8]| {
        let wire = RaftMessage { kind: i32::from(kind), context: name.to_vec().into(), ..RaftMessage::default() };
        let mut message = wire.into_raft(3, 1).unwrap();
        message.term = u64::from(kind != RaftKind::ReadIndex);
        engine.raw.step(message).unwrap();
    };
    raw(&mut engine, RaftKind::ReadIndex, b"a");
    raw(&mut engine, RaftKind::HeartbeatResponse, b"a");
    engine.raw.read_index(b"own".to_vec());
    raw(&mut engine, RaftKind::ReadIndex, b"a");
    raw(&mut engine, RaftKind::HeartbeatResponse, b"a");
    assert_eq!(engine.raw.raft.pending_read_count(), 0, "the crate is repaired: the names can go");
}

#[test]
fn a_heartbeat_that_knows_less_is_answered_with_what_is_committed_on_this_disk() {
    let mut engine = engine(1, &[1, 2, 3], &[]);
    let append = message(2, RaftKind::Append, |message| {
        message.entries = (1..=3).map(|index| WireEntry { index, term: 1, kind: 1, data: Bytes::new() }).collect();
        message.commit = 2;
    });
    let mut out = Vec::new();
    engine.step(0, mandate(1, 2, &[2, 3]), &mut out);
    let append = honest(&engine, append);
    engine.step(0, append, &mut out);
    let heartbeat = |commit| message(2, RaftKind::Heartbeat, |message| message.commit = commit);
    out.clear();
    engine.step(0, heartbeat(0), &mut out);
    let Some(ready) = engine.pending.iter().map(|ready| ready.number).max() else { panic!("a write is under way") };
    engine.store.flush().unwrap();
    engine.step(0, Input::Persisted { ready }, &mut out);
    let held = |out: &[Output]| -> Vec<u64> {
        out.iter()
            .filter_map(|output| match output {
                Output::Send { message: PeerMessage::Raft(message), .. }
                    if message.kind == i32::from(RaftKind::AppendResponse) =>
                {
                    Some(message.index)
                }
                _ => None,
            })
            .collect()
    };
    assert_eq!(held(&out), [3], "the answer to the append; the heartbeat came before anything was on disk");
    let (before, same) = (step(&mut engine, heartbeat(1)), step(&mut engine, heartbeat(2)));
    assert_eq!((held(&before), held(&same)), (vec![2], vec![]));
}
