//! Block time and the clocks of voters.

use super::*;
use crate::engine::time::{RESERVE, time_of};
use bytes::Bytes;

/// The clock of an honest node in these tests, microseconds.
const CLOCK: u64 = 1_000_000_000;
/// A clock a year ahead.
const YEAR_AHEAD: u64 = CLOCK + 365 * 24 * 3600 * 1_000_000;

/// Node 2 of three follows node 1, in term 1.
fn follower() -> Engine {
    let mut engine = engine(2, &[1, 2, 3], &[9]);
    engine.accept_time_until(CLOCK + TIME_AHEAD_MAX);
    step(&mut engine, message(1, RaftKind::Heartbeat, |_| {}));
    engine
}

fn block(index: u64, time: u64) -> WireEntry {
    let data = Payload { time, transactions: Vec::new() }.to_bytes();
    WireEntry { index, term: 1, kind: 1, data }
}

fn append(from: u64, commit: u64, blocks: &[(u64, u64)]) -> Input {
    let entries: Vec<_> = blocks.iter().map(|(index, time)| block(*index, *time)).collect();
    message(from, RaftKind::Append, |message| {
        message.index = blocks.first().map_or(1, |(index, _)| index - 1);
        message.log_term = u64::from(message.index > 0);
        (message.commit, message.entries) = (commit, entries);
    })
}

/// The newest entry that was acknowledged.
fn acknowledged(out: &[Output]) -> Option<u64> {
    let answers = out.iter().filter_map(|output| match output {
        Output::Send { message: PeerMessage::Raft(message), .. } => {
            (message.kind == i32::from(RaftKind::AppendResponse) && !message.reject).then_some(message.index)
        }
        _ => None,
    });
    answers.max()
}

fn vote(kind: RaftKind, from: u64, last: (u64, u64)) -> Input {
    message(from, kind, |message| {
        (message.term, message.log_term, message.index) = (5, last.0, last.1);
    })
}

fn ignores(out: &[Output]) -> bool {
    out.iter().any(|output| matches!(output, Output::Ignored { .. }))
}

fn wait(engine: &mut Engine, timeouts: usize) -> Vec<Output> {
    let ticks = timeouts * engine.config.election_tick;
    (0..ticks).flat_map(|_| step(engine, Input::Tick)).collect()
}

#[test]
fn a_voter_acknowledges_no_block_that_is_further_ahead_of_its_clock_than_the_bound() {
    let mut node = follower();
    assert_eq!(acknowledged(&step(&mut node, append(1, 0, &[(1, CLOCK + TIME_AHEAD_MAX)]))), Some(1));
    let out = step(&mut node, append(1, 0, &[(2, CLOCK + TIME_AHEAD_MAX + 1)]));
    assert_eq!(acknowledged(&out), None);
    assert!(ignores(&out) && node.store.last_index() == 1, "{out:?}");
    let out = step(&mut follower(), append(1, 0, &[(1, CLOCK), (2, YEAR_AHEAD), (3, YEAR_AHEAD)]));
    assert_eq!(acknowledged(&out), Some(1), "the block before it is as good as any");
}

#[test]
fn a_voter_takes_a_block_that_others_have_committed_and_one_that_it_holds_whatever_its_clock_shows() {
    let mut node = follower();
    assert_eq!(acknowledged(&step(&mut node, append(1, 1, &[(1, YEAR_AHEAD)]))), Some(1));
    let mut node = follower();
    node.accept_time_until(YEAR_AHEAD);
    step(&mut node, append(1, 0, &[(1, YEAR_AHEAD)]));
    node.accept_time_until(CLOCK);
    // What it has just said it does not say again before the next heartbeat.
    (0..node.config.heartbeat_tick).for_each(|_| drop(step(&mut node, Input::Tick)));
    assert_eq!(acknowledged(&step(&mut node, append(1, 0, &[(1, YEAR_AHEAD)]))), Some(1), "it has promised it");
}

#[test]
fn a_learner_takes_what_it_is_given() {
    let mut node = engine(9, &[1, 2, 3], &[9]);
    node.accept_time_until(CLOCK);
    assert_eq!(acknowledged(&step(&mut node, append(1, 0, &[(1, YEAR_AHEAD)]))), Some(1));
}

#[test]
fn a_leader_of_a_refused_block_is_heard_by_nobody_until_others_were_elected_or_have_committed_it() {
    let refuses = || {
        let mut node = follower();
        step(&mut node, append(1, 0, &[(1, YEAR_AHEAD)]));
        node
    };
    let heartbeat = |from: u64, term: u64| message(from, RaftKind::Heartbeat, move |message| message.term = term);
    assert!(ignores(&step(&mut refuses(), heartbeat(1, 1))));
    assert!(ignores(&step(&mut refuses(), append(1, 0, &[(1, CLOCK)]))));
    assert!(!ignores(&step(&mut refuses(), heartbeat(3, 2))), "another leader");
    assert_eq!(acknowledged(&step(&mut refuses(), append(1, 1, &[(1, YEAR_AHEAD)]))), Some(1), "it is committed");
    let mut node = refuses();
    let out = wait(&mut node, 2);
    assert!(sent(&out).contains(&RaftKind::PreVote), "it stands for election: {out:?}");
    assert!(!ignores(&step(&mut node, heartbeat(1, 1))), "nobody else was elected");
}

#[test]
fn a_voter_does_not_vote_for_a_node_whose_log_ends_with_what_it_refuses() {
    let refuses = || {
        let mut node = follower();
        step(&mut node, append(1, 0, &[(1, CLOCK), (2, YEAR_AHEAD), (3, YEAR_AHEAD)]));
        wait(&mut node, 2);
        node
    };
    for kind in [RaftKind::Vote, RaftKind::PreVote] {
        for last in [(1, 2), (1, 3)] {
            assert!(ignores(&step(&mut refuses(), vote(kind, 1, last))), "{kind:?} for a log to {last:?}");
        }
        assert!(!ignores(&step(&mut refuses(), vote(kind, 1, (1, 1)))), "it does not hold the block any more");
        assert!(!ignores(&step(&mut refuses(), vote(kind, 1, (2, 4)))), "another leader has replaced it");
        assert!(!ignores(&step(&mut refuses(), vote(kind, 3, (1, 3)))), "another node has not offered it");
        let mut node = refuses();
        node.accept_time_until(YEAR_AHEAD);
        assert!(!ignores(&step(&mut node, vote(kind, 1, (1, 3)))), "its time has come");
    }
}

#[test]
fn answers_say_how_far_a_voter_goes() {
    let mut node = follower();
    for input in [append(1, 0, &[(1, CLOCK)]), message(1, RaftKind::Heartbeat, |_| {})] {
        let out = step(&mut node, input);
        let said: Vec<u64> = out
            .iter()
            .filter_map(|output| match output {
                Output::Send { message: PeerMessage::Raft(message), .. } => Some(message.accepts_until),
                _ => None,
            })
            .collect();
        assert_eq!(said, [CLOCK + TIME_AHEAD_MAX], "{out:?}");
    }
}

/// A voter says how far it goes.
fn told(engine: &mut Engine, from: u64, accepts_until: u64) {
    step(engine, message(from, RaftKind::HeartbeatResponse, move |message| message.accepts_until = accepts_until));
}

#[test]
fn a_leader_keeps_to_the_clocks_of_a_majority() {
    let mut node = leader(0);
    node.accept_time_until(YEAR_AHEAD + TIME_AHEAD_MAX);
    assert_eq!(node.block_time(YEAR_AHEAD), 0, "nobody has said anything");
    told(&mut node, 2, CLOCK + TIME_AHEAD_MAX);
    told(&mut node, 3, CLOCK + TIME_AHEAD_MAX - 300);
    assert_eq!(node.block_time(YEAR_AHEAD), CLOCK + TIME_AHEAD_MAX - RESERVE, "itself and node 2");
    assert_eq!(node.block_time(CLOCK), CLOCK);
    node.accept_time_until(0);
    assert_eq!(node.block_time(YEAR_AHEAD), CLOCK + TIME_AHEAD_MAX - RESERVE - 300, "nodes 2 and 3");
    node.last_time = CLOCK + TIME_AHEAD_MAX;
    assert_eq!(node.block_time(CLOCK), CLOCK + TIME_AHEAD_MAX, "time never goes back");
}

#[test]
fn a_voter_that_is_silent_does_not_move_block_time_ahead_of_those_that_must_acknowledge_it() {
    let mut node = leader(0);
    node.accept_time_until(YEAR_AHEAD + TIME_AHEAD_MAX);
    told(&mut node, 2, CLOCK + TIME_AHEAD_MAX);
    told(&mut node, 3, YEAR_AHEAD + TIME_AHEAD_MAX);
    assert_eq!(node.block_time(YEAR_AHEAD), YEAR_AHEAD, "most clocks are a year ahead");
    for _ in 0..=node.config.election_tick {
        told(&mut node, 2, CLOCK + TIME_AHEAD_MAX);
        step(&mut node, Input::Tick);
    }
    assert!(node.is_leader());
    assert_eq!(node.block_time(YEAR_AHEAD), CLOCK + TIME_AHEAD_MAX - RESERVE, "node 2 must acknowledge it");
    told(&mut node, 3, YEAR_AHEAD + TIME_AHEAD_MAX);
    assert_eq!(node.block_time(YEAR_AHEAD), YEAR_AHEAD, "node 3 is back");
}

#[test]
fn in_a_joint_configuration_the_majorities_of_both_sets_count() {
    let mut node = leader(0);
    node.membership = Membership { outgoing: [1, 4, 5].into(), ..Membership::new([1, 2, 3], []) };
    for (from, clock) in [(2, CLOCK), (3, CLOCK), (4, CLOCK - 7), (5, 0)] {
        node.heard.insert(from, node.ticks);
        told(&mut node, from, clock + TIME_AHEAD_MAX);
    }
    assert_eq!(node.block_time(YEAR_AHEAD), CLOCK - 7 + TIME_AHEAD_MAX - RESERVE);
}

#[test]
fn a_block_has_the_time_that_a_majority_acknowledges() {
    let mut node = leader(0);
    node.accept_time_until(CLOCK);
    told(&mut node, 2, 500 + RESERVE);
    let out = step(&mut node, Input::Submit { lane: Lane::Data, transaction: Bytes::from_static(b"drive") });
    let times: Vec<u64> = out
        .iter()
        .filter_map(|output| match output {
            Output::Send { message: PeerMessage::Raft(message), .. } => message.entries.iter().map(time_of).max(),
            _ => None,
        })
        .collect();
    assert_eq!(times, [500], "{out:?}");
}
