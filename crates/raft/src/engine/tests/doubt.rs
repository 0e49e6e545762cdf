//! A voter that is alone and does not believe its clock.

use super::*;
use crate::message::Transactions;
use bytes::Bytes;
use ledger_base::rejection::Code;

fn submit(engine: &mut Engine) -> Vec<Output> {
    step(engine, Input::Submit { lane: Lane::Control, transaction: Bytes::from_static(b"drive") })
}

fn refused(out: &[Output]) -> Option<String> {
    out.iter().find_map(|output| match output {
        Output::Dropped { reason, .. } if reason.code == Code::ClockJumped => Some(reason.to_string()),
        _ => None,
    })
}

#[test]
fn the_only_voter_orders_nothing_while_its_clock_is_in_doubt_and_goes_on_by_itself() {
    let mut node = engine(1, &[1], &[9]);
    step(&mut node, Input::Tick);
    submit(&mut node);
    let before = node.store.last_index();
    for (doubt, said) in
        [(ClockDoubt::Ahead(3_600_000_000), "jumped ahead"), (ClockDoubt::Behind(7_000_000), "behind block time")]
    {
        node.doubt_clock(Some(doubt));
        let reason = refused(&submit(&mut node)).unwrap();
        assert!(reason.contains(said) && reason.contains("--trust-clock"), "{reason}");
        step(&mut node, Input::ProposeEmpty);
        let sent = Transactions { control: Vec::new(), data: vec![Bytes::from_static(b"drive")], code: 0 };
        let out = step(&mut node, Input::Message { from: 9, message: PeerMessage::Forward(sent) });
        let returned = out.iter().any(|output| match output {
            Output::Send { to: 9, message: PeerMessage::Returned(returned) } => returned.code == 4007,
            _ => false,
        });
        assert!(returned, "{out:?}");
    }
    assert_eq!(node.store.last_index(), before);
    assert!(node.needs_ticks(), "somebody looks whether the clock is right again");
    node.doubt_clock(None);
    assert_eq!(refused(&submit(&mut node)), None);
    assert_eq!(node.store.last_index(), before + 1, "what was due, with the transaction");
}

#[test]
fn where_others_vote_they_judge_the_clock() {
    let mut node = leader(1);
    node.doubt_clock(Some(ClockDoubt::Ahead(3_600_000_000)));
    let before = node.store.last_index();
    assert_eq!(refused(&submit(&mut node)), None);
    assert_eq!(node.store.last_index(), before + 1);
}
