//! Calls of which readers are told before they are ordered.

use super::world::{Caller, NOW, SECOND, World, block};
use ledger::Ledger;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_identity::key::KeyKind;

fn subjects(ledger: &Ledger, call: &Transaction, now: u64) -> Option<Vec<String>> {
    Some(ledger.foresee(call, now)?.into_iter().map(|event| event.subject).collect())
}

#[test]
fn a_call_that_is_told_early_is_told_with_its_events_and_changes_nothing() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let halt = salma.sign(&salma.body(world.network, "halt", &["Husky"]));
    let before = ledger.tip();
    for _ in 0..2 {
        assert_eq!(subjects(&ledger, &halt, NOW), Some(vec!["Husky".to_owned()]));
    }
    assert_eq!(ledger.tip(), before);
    let put = salma.sign(&salma.body(world.network, "put", &["a", "1"]));
    assert_eq!(ledger.foresee(&put, NOW), None, "other calls are told in their blocks");
}

#[test]
fn a_call_that_was_executed_or_would_be_refused_is_not_told_early() {
    let world = World::new();
    let ledger = world.ledger();
    let salma = world.org1.user("Salma", "member", KeyKind::Ed25519);
    let mallory = world.org1.user("Mallory", "member", KeyKind::Ed25519);
    let halt = |of: &str| salma.sign(&salma.body(world.network, "halt", &[of]));

    let refused = mallory.sign(&mallory.body(world.network, "halt", &["Husky"]));
    assert_eq!(ledger.foresee(&refused, NOW), None, "policies do not let her");
    let forged = Transaction::sign(&salma.body(world.network, "halt", &["Husky"]), &mallory.key).unwrap();
    let forged = forged.with_certificate(salma.certificate.clone()).unwrap();
    assert_eq!(ledger.foresee(&forged, NOW), None, "she did not sign it");
    let elsewhere = salma.sign(&salma.body(Hash::ZERO, "halt", &["Husky"]));
    assert_eq!(ledger.foresee(&elsewhere, NOW), None, "it is of another network");
    assert_eq!(ledger.foresee(&halt("Husky"), NOW + 61 * SECOND), None, "its time has passed");

    let executed = halt("Husky");
    block(&ledger, NOW, &[&executed]);
    assert_eq!(ledger.foresee(&executed, NOW), None, "a replay stops nobody");
    assert_eq!(ledger.foresee(&halt("Husky"), NOW), None, "it stands already");
    assert_eq!(subjects(&ledger, &halt("Turtlebot4"), NOW), Some(vec!["Turtlebot4".to_owned()]));
}
