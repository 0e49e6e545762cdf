//! The rules of execution: each test fails if its rule is taken away.
#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]

mod admission;
mod archive;
mod beside;
mod certified;
mod early;
mod evidence;
mod results;
mod snapshot;
mod together;
mod world;

use bytes::Bytes;
use ledger::block::Payload;
use ledger::transaction::SIGNED_WHOLE_MAX;
use ledger::transaction::Transaction;
use ledger::{Admission, Ground};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::{Entry, EntryKind};
use world::{Caller, NOW, SECOND, World, block, codes, entry, note};

#[test]
fn a_signed_call_is_executed_and_answered() {
    let world = World::new();
    let ledger = world.ledger();
    for kind in [KeyKind::Ed25519, KeyKind::P256] {
        let salma = world.org1.user("Salma", "member", kind);
        let outcome = block(&ledger, NOW, &[&salma.sign(&salma.body(world.network, "put", &["a", "1"]))]);
        assert_eq!(outcome.results[0].outcome().unwrap(), "Org1/Salma");
        assert_eq!(outcome.events[0].event.subject, "a");
        assert_eq!(outcome.events[0].index, Some(0));
        assert_eq!(note(&ledger, &salma, "a"), "1");
    }
}

#[test]
fn a_transaction_is_executed_once_in_a_block_and_across_blocks() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::P256);
    let body = salma.body(world.network, "put", &["a", "1"]);
    let first = salma.sign(&body);
    // Another signature over the same body is the same transaction.
    let again = salma.sign(&body);
    assert_eq!(first.id(), again.id());
    assert_ne!(first.encoded(), again.encoded(), "ECDSA signs differently each time");
    assert_eq!(codes(&block(&ledger, NOW, &[&first, &again])), [Code::Ok, Code::Duplicate]);
    let outcome = block(&ledger, NOW + SECOND, &[&again]);
    assert_eq!(codes(&outcome), [Code::Duplicate]);
    assert!(outcome.events.is_empty());
    let record = ledger.transaction(&first.id()).unwrap().unwrap();
    assert_eq!((record.height, record.index, record.result.code()), (1, 0, Code::Ok));
    let Admission::Known(id, known) = ledger.admit(again.encoded().clone(), NOW).unwrap() else {
        panic!("ordered again")
    };
    assert_eq!((id, known), (first.id(), record));
}

#[test]
fn a_forged_copy_does_not_use_up_the_id() {
    let world = World::new();
    let ledger = world.ledger();
    let (salma, mallory) =
        (world.org1.user("Salma", "member", KeyKind::Ed25519), world.org1.user("M", "member", KeyKind::Ed25519));
    let body = salma.body(world.network, "put", &["a", "1"]);
    let forged = Transaction::sign(&body, &mallory.key).unwrap().with_certificate(salma.certificate.clone()).unwrap();
    let genuine = salma.sign(&body);
    assert_eq!(forged.id(), genuine.id());
    assert_eq!(codes(&block(&ledger, NOW, &[&forged, &genuine])), [Code::BadSignature, Code::Ok]);
}

#[test]
fn a_long_transaction_may_be_signed_by_its_id() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let long = "x".repeat(SIGNED_WHOLE_MAX);
    let body = salma.body(world.network, "put", &["a", &long]);
    let by_id = Transaction::sign_by_id(&body, &salma.key).unwrap();
    let by_id = by_id.with_certificate(salma.certificate.clone()).unwrap();
    let whole = salma.sign(&salma.body(world.network, "put", &["b", &long]));
    let admitted = ledger.admit(by_id.encoded().clone(), NOW).map_err(|refused| refused.ground);
    assert_eq!(admitted, Ok(Admission::New(by_id.clone())));
    assert_eq!(codes(&block(&ledger, NOW, &[&by_id, &whole])), [Code::Ok, Code::Ok]);
    let mallory = world.org1.user("M", "member", KeyKind::Ed25519);
    let forged = Transaction::sign_by_id(&salma.body(world.network, "put", &["c", &long]), &mallory.key).unwrap();
    let refused = ledger.admit(forged.encoded().clone(), NOW).unwrap_err();
    assert_eq!((refused.rejection.code, refused.ground), (Code::BadSignature, Ground::Bytes));
    assert_eq!(codes(&block(&ledger, NOW, &[&forged])), [Code::BadSignature]);
}

#[test]
fn a_reused_nonce_is_another_transaction_unless_everything_is_equal() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let first = salma.body(world.network, "put", &["a", "1"]);
    let mut second = salma.body(world.network, "put", &["a", "2"]);
    second.nonce = first.nonce.clone();
    let outcome = block(&ledger, NOW, &[&salma.sign(&first), &salma.sign(&second), &salma.sign(&first)]);
    assert_eq!(codes(&outcome), [Code::Ok, Code::Ok, Code::Duplicate]);
}

#[test]
fn time_windows_are_kept_by_block_time() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let with = |not_after| {
        let mut body = salma.body(world.network, "put", &["a", "1"]);
        body.not_after = not_after;
        salma.sign(&body)
    };
    let (late, just, far, too_far) = (with(NOW - 1), with(NOW), with(NOW + 120 * SECOND), with(NOW + 120 * SECOND + 1));
    let outcome = block(&ledger, NOW, &[&late, &just, &far, &too_far]);
    assert_eq!(codes(&outcome), [Code::Expired, Code::Ok, Code::Ok, Code::NotAfterTooFar]);
    assert_eq!(ledger.admit(with(NOW - 1).encoded().clone(), NOW).unwrap_err().rejection.code, Code::Expired);
}

#[test]
fn block_time_never_goes_back() {
    let world = World::new();
    let ledger = world.ledger();
    assert_eq!(block(&ledger, NOW, &[]).header.time, NOW);
    assert_eq!(block(&ledger, NOW - 5 * SECOND, &[]).header.time, NOW);
    assert_eq!(block(&ledger, NOW + SECOND, &[]).header.time, NOW + SECOND);
}

#[test]
fn certificates_travel_once() {
    let world = World::new();
    let ledger = world.ledger();
    let (salma, farhad) =
        (world.org1.user("Salma", "member", KeyKind::Ed25519), world.org1.user("Farhad", "member", KeyKind::Ed25519));
    let bare = |value| Transaction::sign(&salma.body(world.network, "put", &["a", value]), &salma.key).unwrap();
    let wrong = bare("0").with_certificate(farhad.certificate.clone()).unwrap();
    let first = salma.sign(&salma.body(world.network, "put", &["a", "2"]));
    let outcome = block(&ledger, NOW, &[&bare("1"), &wrong, &first, &bare("3")]);
    assert_eq!(codes(&outcome), [Code::UnknownCreator, Code::UnknownCreator, Code::Ok, Code::Ok]);
    assert_eq!(ledger.creator_name(&first.creator()).unwrap(), "Org1/Salma");
}

#[test]
fn strangers_and_other_networks_are_refused() {
    let world = World::new();
    let ledger = world.ledger();
    let stranger = world::Ca::new("org1-ca").user("Salma", "member", KeyKind::Ed25519);
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let elsewhere = salma.sign(&salma.body(Hash::ZERO, "put", &["a", "1"]));
    let outcome = block(&ledger, NOW, &[&stranger.sign(&stranger.body(world.network, "put", &["a", "1"])), &elsewhere]);
    assert_eq!(codes(&outcome), [Code::Untrusted, Code::WrongNetwork]);
}

#[test]
fn a_certificate_counts_only_within_its_validity_in_block_time() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let two_years = 2 * 366 * 24 * 3600 * SECOND;
    let later = NOW + two_years;
    let mut body = salma.body(world.network, "put", &["a", "1"]);
    assert_eq!(codes(&block(&ledger, NOW, &[&salma.sign(&body)])), [Code::Ok], "the identity is remembered from here");
    (body.not_after, body.nonce) = (later, Bytes::from_static(&[9; 16]));
    assert_eq!(codes(&block(&ledger, later, &[&salma.sign(&body)])), [Code::CertificateExpired]);
}

#[test]
fn a_panic_or_refusal_undoes_the_call_and_nothing_else() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let call = |function: &str, args: &[&str]| salma.sign(&salma.body(world.network, function, args));
    let outcome = block(
        &ledger,
        NOW,
        &[
            &call("put", &["kept", "1"]),
            &call("put-then-panic", &["kept"]),
            &call("put-then-refuse", &["kept"]),
            &call("nested-failure", &["outer"]),
            &call("forever", &[]),
            &call("too-much", &[]),
            &call("nonsense", &[]),
        ],
    );
    use Code::{ChaincodePanic, LimitExceeded, Ok, Refused, UnknownFunction};
    assert_eq!(codes(&outcome), [Ok, ChaincodePanic, Refused, Ok, LimitExceeded, LimitExceeded, UnknownFunction]);
    assert_eq!(outcome.events.len(), 1, "events of failed calls are not told");
    assert_eq!((note(&ledger, &salma, "kept").as_str(), note(&ledger, &salma, "outer").as_str()), ("1", "outer"));
    assert_eq!(note(&ledger, &salma, "inner"), "");
}

#[test]
fn unknown_chaincodes_and_garbage_are_refused_and_the_block_goes_on() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let mut body = salma.body(world.network, "put", &["a", "1"]);
    body.chaincode = "nobody".into();
    let unknown = salma.sign(&body).encoded().clone();
    let good = salma.sign(&salma.body(world.network, "put", &["a", "1"])).encoded().clone();
    let transactions = vec![Bytes::from_static(b"\xff\xff garbage"), Bytes::new(), unknown, good];
    let data = Payload { time: NOW, transactions }.to_bytes();
    let outcome = ledger.apply(&Entry { index: 1, term: 1, kind: EntryKind::Normal, data }).unwrap();
    assert_eq!(codes(&outcome), [Code::Malformed, Code::Malformed, Code::UnknownChaincode, Code::Ok]);
    // An entry that is no payload at all is an empty block, on every node alike.
    let outcome = ledger
        .apply(&Entry { index: 2, term: 1, kind: EntryKind::Normal, data: Bytes::from_static(b"\xff\xff") })
        .unwrap();
    assert!(outcome.results.is_empty());
}

#[test]
fn a_revoked_identity_has_no_effect_from_the_revoking_transaction_on() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let (admin, other) =
        (world.org1.user("Admin", "admin", KeyKind::Ed25519), world.org2.user("Admin", "admin", KeyKind::Ed25519));
    let identity = ledger.msps().verify(&salma.certificate, &[], NOW).unwrap();
    let (issuer, serial) = (hex::encode(identity.issuer), hex::encode(&identity.serial));
    let revoke = |by: &world::User| {
        let mut body = by.body(world.network, "revoke", &[&issuer, &serial, "lost laptop"]);
        body.chaincode = "msp".into();
        by.sign(&body)
    };
    let put = || salma.sign(&salma.body(world.network, "put", &["a", "1"]));
    let outcome = block(&ledger, NOW, &[&put(), &revoke(&other), &revoke(&salma), &put(), &revoke(&admin), &put()]);
    assert_eq!(codes(&outcome), [Code::Ok, Code::NotAdmin, Code::NotAdmin, Code::Ok, Code::Ok, Code::Revoked]);
    assert_eq!(codes(&block(&ledger, NOW, &[&put()])), [Code::Revoked]);
    assert_eq!(ledger.admit(put().encoded().clone(), NOW).unwrap_err().rejection.code, Code::Revoked);
    assert_eq!(note(&ledger, &admin, "last-revoked"), serial, "other chaincodes were told in the same block");
    assert_eq!(
        ledger.query(&identity, NOW, "notes", "get", &[Bytes::from_static(b"a")]).unwrap_err().code,
        Code::Revoked
    );
}

#[test]
fn what_would_be_refused_is_refused_before_ordering_with_its_sender() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let refused = ledger
        .admit(salma.sign(&salma.body(world.network, "put-then-refuse", &["a"])).encoded().clone(), NOW)
        .unwrap_err();
    assert_eq!((refused.who.as_deref(), refused.rejection.code), (Some("Org1/Salma"), Code::Refused));
    assert_eq!(ledger.tip().height, 0);
}

#[test]
fn hooks_run_before_the_transactions_and_deadlines_are_known() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    block(&ledger, NOW, &[&salma.sign(&salma.body(world.network, "put", &["alarm", "42"]))]);
    assert_eq!(ledger.next_deadline(), Some(42));
    let outcome = block(&ledger, NOW, &[]);
    assert_eq!((outcome.events[0].event.name.as_str(), outcome.events[0].index), ("rang", None));
    assert_eq!(ledger.next_deadline(), None);
}

#[test]
fn a_question_is_judged_before_the_next_end_whatever_the_clock_of_the_node_says_and_no_earlier_than_its_block() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    block(&ledger, NOW, &[]);
    for (now, judged_at) in [(NOW - SECOND, NOW), (NOW, NOW), (NOW + 3600 * SECOND, NOW + 3600 * SECOND)] {
        assert_eq!(ledger.judged_at(now), judged_at, "nothing ends by itself");
    }
    let ends = NOW + 10 * SECOND;
    block(&ledger, NOW, &[&salma.sign(&salma.body(world.network, "put", &["alarm", &ends.to_string()]))]);
    let identity = ledger.msps().verify(&salma.certificate, &[], NOW).unwrap();
    let until = Bytes::from((ends - 1).to_string());
    for (now, judged_at) in [(ends - 2, ends - 2), (ends, ends - 1), (NOW + 3600 * SECOND, ends - 1)] {
        assert_eq!(ledger.judged_at(now), judged_at);
        let asked = ledger.query(&identity, now, "notes", "until", std::slice::from_ref(&until));
        assert!(asked.is_ok(), "the block that ends it has not come: {asked:?}");
    }
    block(&ledger, ends, &[]);
    assert_eq!(ledger.judged_at(NOW), ends, "the block has ended it");
}

#[test]
fn events_are_shown_only_to_those_who_may_read_them() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let outcome = block(&ledger, NOW, &[&salma.sign(&salma.body(world.network, "put", &["secret", "1"]))]);
    let reader = |user: &world::User| ledger.msps().verify(&user.certificate, &[], NOW).unwrap();
    let other = world.org2.user("Other", "member", KeyKind::Ed25519);
    ledger.may_read(&reader(&salma), &outcome.events[0].event).unwrap();
    assert_eq!(ledger.may_read(&reader(&other), &outcome.events[0].event).unwrap_err().code, Code::DeniedByPolicy);
}

#[test]
fn only_the_next_block_is_applied() {
    let world = World::new();
    let ledger = world.ledger();
    let first = entry(&ledger, NOW, &[]);
    ledger.apply(&first).unwrap();
    assert_eq!(ledger.apply(&first).unwrap_err().code, Code::ChainInvalid);
    assert_eq!(ledger.apply(&Entry { index: 3, ..first.clone() }).unwrap_err().code, Code::ChainInvalid);
    assert_eq!(ledger.apply(&Entry { index: 2, term: 0, ..first }).unwrap_err().code, Code::ChainInvalid);
}

#[test]
fn every_node_computes_the_same_whatever_it_has_seen_before() {
    let world = World::new();
    let (cold, warm) = (world.ledger(), world.ledger());
    let users: Vec<_> = (0..4).map(|i| world.org1.user(&format!("user{i}"), "member", KeyKind::P256)).collect();
    for height in 0..20u64 {
        let calls: Vec<_> = (0..10)
            .map(|i| {
                let (user, key) =
                    (&users[(height as usize + i) % users.len()], format!("k{}", (height as usize * i) % 7));
                let function = ["put", "put-then-refuse", "put-then-panic"][i % 3];
                let args = if function == "put" { vec![key.as_str(), "v"] } else { vec![key.as_str()] };
                user.sign(&user.body(world.network, function, &args))
            })
            .collect();
        // One node admits everything first, so that signatures and identities are remembered; the other nothing.
        for call in &calls {
            let _refused = warm.admit(call.encoded().clone(), NOW);
        }
        let calls: Vec<_> = calls.iter().collect();
        let entry = entry(&cold, NOW + height, &calls);
        let (a, b) = (cold.apply(&entry).unwrap(), warm.apply(&entry).unwrap());
        assert_eq!(a, b);
        if height == 10 {
            cold.flush(None).unwrap();
        }
    }
    assert_eq!(cold.tip(), warm.tip());
    assert_eq!(cold.state().world(None, 1000).unwrap(), warm.state().world(None, 1000).unwrap());
}

#[test]
fn the_digest_covers_writes_and_verdicts() {
    let world = World::new();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let digest_after = |function: &str, args: &[&str]| {
        let ledger = world.ledger();
        block(&ledger, NOW, &[&salma.sign(&salma.body(world.network, function, args))]).digest
    };
    let digests = [
        digest_after("put", &["a", "1"]),
        digest_after("put", &["a", "2"]),
        digest_after("put", &["b", "1"]),
        digest_after("put-then-refuse", &["a"]),
        digest_after("put-then-panic", &["a"]),
    ];
    for (i, digest) in digests.iter().enumerate() {
        assert!(!digests[..i].contains(digest), "case {i}");
    }
}

#[test]
fn execution_goes_on_from_a_stored_state_and_gives_the_same() {
    let world = World::new();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let directory = tempfile::tempdir().unwrap();
    let results = SimDisk::new(1);
    let straight = world.ledger();
    let mut entries = Vec::new();
    {
        let ledger = world.ledger_on(directory.path(), &results);
        for height in 0..6u64 {
            let call = salma.sign(&salma.body(world.network, "put", &["a", &height.to_string()]));
            entries.push(entry(&ledger, NOW + height, &[&call]));
            ledger.apply(entries.last().unwrap()).unwrap();
            if height == 3 {
                ledger.flush(None).unwrap();
            }
        }
    }
    for entry in &entries {
        straight.apply(entry).unwrap();
    }
    let ledger = world.ledger_on(directory.path(), &results);
    assert_eq!(ledger.tip().height, 4, "what was not flushed is to be executed again");
    for entry in &entries[4..] {
        ledger.apply(entry).unwrap();
    }
    assert_eq!(ledger.tip(), straight.tip());
    let other = World::new();
    ledger.flush(None).unwrap();
    drop(ledger);
    let refused = other.open_on(directory.path(), &results).map(drop).unwrap_err();
    assert_eq!(refused.code, Code::Corrupt, "a state of another network is not taken");
}
