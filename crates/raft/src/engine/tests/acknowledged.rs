//! Followers say once what they have acknowledged.

use super::*;

#[test]
fn a_follower_does_not_answer_when_it_is_told_of_a_commit_of_what_it_has_just_acknowledged() {
    let mut engine = engine(1, &[1, 2, 3], &[]);
    let entry = WireEntry { index: 1, term: 1, kind: 1, data: Bytes::new() };
    let out = step(&mut engine, message(2, RaftKind::Append, |message| message.entries = vec![entry]));
    assert_eq!(sent(&out), [RaftKind::AppendResponse]);
    let told = || message(2, RaftKind::Append, |message| (message.index, message.log_term, message.commit) = (1, 1, 1));
    assert_eq!(sent(&step(&mut engine, told())), []);
    assert_eq!(engine.emitted, 1, "it hears of the commit all the same");
    // The acknowledgement may have been lost: the leader asks again after a heartbeat.
    (0..engine.config.heartbeat_tick).for_each(|_| drop(step(&mut engine, Input::Tick)));
    assert_eq!(sent(&step(&mut engine, told())), [RaftKind::AppendResponse]);
}
