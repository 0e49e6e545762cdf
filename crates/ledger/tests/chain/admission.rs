//! The answers that a node may give about a transaction that it would refuse.

use crate::world::{Caller, NOW, SECOND, User, World, block, codes};
use ledger::transaction::{NOT_AFTER_AHEAD_MAX, Transaction};
use ledger::{Admission, Ground, Ledger, Refusal, Step};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::key::KeyKind;

fn call(world: &World, user: &User, function: &str, args: &[&str]) -> Transaction {
    user.sign(&user.body(world.network, function, args))
}

fn refused(ledger: &Ledger, transaction: &Transaction, now: u64) -> Refusal {
    *ledger.admit(transaction.encoded().clone(), now).unwrap_err()
}

fn ground(ledger: &Ledger, transaction: &Transaction, now: u64) -> (Code, Ground) {
    let refused = refused(ledger, transaction, now);
    (refused.rejection.code, refused.ground)
}

#[test]
fn a_refusal_says_what_it_rests_on() {
    let world = World::new();
    let ledger = world.ledger();
    let (salma, stranger) = (world.org1.user("Salma", "member", KeyKind::Ed25519), World::new());
    block(&ledger, NOW, &[&call(&world, &salma, "put", &["a", "1"])]);
    let denied = call(&world, &salma, "put-then-refuse", &["a"]);
    assert_eq!(ground(&ledger, &denied, NOW), (Code::Refused, Ground::Judged { height: 1 }));
    let elsewhere = salma.sign(&salma.body(Hash::ZERO, "put", &["a", "1"]));
    assert_eq!(ground(&ledger, &elsewhere, NOW), (Code::WrongNetwork, Ground::Bytes));
    let farhad = stranger.org1.user("Farhad", "member", KeyKind::Ed25519);
    let unknown = call(&world, &farhad, "put", &["a", "1"]);
    assert_eq!(ground(&ledger, &unknown, NOW), (Code::Untrusted, Ground::State { height: 1 }));
    let bare = Transaction::sign(&farhad.body(world.network, "put", &["a", "1"]), &farhad.key).unwrap();
    assert_eq!(ground(&ledger, &bare, NOW), (Code::UnknownCreator, Ground::State { height: 1 }));
    let late = call(&world, &salma, "put", &["a", "1"]);
    let after = late.body().not_after + 1;
    let by_the_clock = ledger.admit(late.encoded().clone(), after);
    assert!(matches!(by_the_clock, Ok(Admission::New(_))), "a block may still execute it: {by_the_clock:?}");
    block(&ledger, after, &[]);
    assert_eq!(ground(&ledger, &late, after), (Code::Expired, Ground::Past), "no block can");
    let ledger = world.ledger();
    let mut body = salma.body(world.network, "put", &["a", "1"]);
    body.not_after = NOW + 2 * NOT_AFTER_AHEAD_MAX;
    let early = ground(&ledger, &salma.sign(&body), NOW);
    assert_eq!(early, (Code::NotAfterTooFar, Ground::State { height: 0 }), "in a while it can be executed");
}

#[test]
fn a_call_is_judged_as_in_the_next_block_and_not_as_in_the_last_one() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    for height in 1..=3 {
        let call = call(&world, &salma, "once-a-block", &["a"]);
        assert!(matches!(ledger.admit(call.encoded().clone(), NOW), Ok(Admission::New(_))), "{height}");
        block(&ledger, NOW + height, &[&call]);
    }
}

#[test]
fn a_clock_that_is_ahead_refuses_nothing_that_a_block_may_still_allow() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    block(&ledger, NOW, &[]);
    let lease = call(&world, &salma, "until", &[&(NOW + SECOND).to_string()]);
    for now in [NOW, NOW + SECOND, NOW + 9 * SECOND] {
        assert!(matches!(ledger.admit(lease.encoded().clone(), now), Ok(Admission::New(_))), "{now}");
    }
    block(&ledger, NOW + 2 * SECOND, &[]);
    assert_eq!(ground(&ledger, &lease, NOW), (Code::Refused, Ground::Judged { height: 2 }), "block time has passed it");
}

#[test]
fn a_copy_that_comes_after_its_time_is_expired_in_the_chain_and_the_first_verdict_is_what_everybody_is_told() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let note = call(&world, &salma, "put", &["a", "1"]);
    let after = note.body().not_after + SECOND;
    assert_eq!(codes(&block(&ledger, NOW, &[&note])), [Code::Ok]);
    assert_eq!(codes(&block(&ledger, after, &[&note])), [Code::Expired], "the same bytes, ordered again");
    let first = |record: ledger::TransactionRecord| (record.height, record.result.code());
    assert_eq!(ledger.transaction(&note.id()).unwrap().map(first), Some((1, Code::Ok)));
    for now in [NOW, after, after + 1000 * SECOND] {
        match ledger.admit(note.encoded().clone(), now).unwrap() {
            Admission::Known(id, record) => assert_eq!((id, first(record)), (note.id(), (1, Code::Ok))),
            Admission::New(_) => panic!("it was executed"),
        }
    }
}

#[test]
fn only_a_state_that_is_new_enough_refuses_and_only_a_first_attempt_is_refused_for_good() {
    let refusal =
        |code, ground| Refusal { who: None, transaction: None, rejection: Rejection::new(code, "no"), ground };
    let denied = refusal(Code::Held, Ground::Judged { height: 7 });
    let answer = |step| match step {
        Step::Answer(reason) => reason.code,
        other => panic!("{other:?} is no answer"),
    };
    for first_attempt in [true, false] {
        assert_eq!(denied.step(first_attempt, None), Step::Reach);
        let no_leader = Err(Rejection::new(Code::NoLeader, "no leader is known"));
        assert_eq!(answer(denied.step(first_attempt, Some(&no_leader))), Code::NoLeader);
        assert_eq!(answer(denied.step(first_attempt, Some(&Ok(8)))), Code::Timeout, "still not new enough");
        // What was executed, and what can never be, needs no other node.
        for ground in [Ground::Bytes, Ground::Past] {
            assert_eq!(answer(refusal(Code::Revoked, ground).step(first_attempt, None)), Code::Revoked);
        }
        // A node's own trouble promises nothing by its code.
        assert_eq!(answer(refusal(Code::DiskFull, Ground::Node).step(first_attempt, None)), Code::DiskFull);
    }
    assert_eq!(answer(denied.step(true, Some(&Ok(7)))), Code::Held);
    assert_eq!(denied.step(false, Some(&Ok(7))), Step::Order);
    let untrusted = refusal(Code::Untrusted, Ground::State { height: 7 });
    assert_eq!(answer(untrusted.step(true, Some(&Ok(7)))), Code::Untrusted);
    assert_eq!(answer(untrusted.step(false, Some(&Ok(7)))), Code::Timeout, "ordered it would take no id");
    let bare = refusal(Code::UnknownCreator, Ground::State { height: 7 });
    assert_eq!(answer(bare.step(false, Some(&Ok(7)))), Code::UnknownCreator, "it says what is missing");
    let large = refusal(Code::TooLarge, Ground::Node);
    assert_eq!((answer(large.step(true, None)), answer(large.step(false, None))), (Code::TooLarge, Code::Timeout));
}

#[test]
fn codes_that_promise_nothing_are_those_of_nodes_and_the_one_that_asks_for_a_certificate() {
    assert!(Code::Held.is_final() && Code::Expired.is_final() && Code::Revoked.is_final());
    for code in [Code::UnknownCreator, Code::Timeout, Code::NoLeader, Code::Overloaded, Code::DiskFull, Code::Internal]
    {
        assert!(!code.is_final(), "{code}");
    }
}
