//! Signatures that are checked together: the same verdicts as if each were checked alone.

use crate::world::{Caller, NOW, User, World, block, codes, entry};
use ledger::transaction::Transaction;
use ledger::{Admission, Ledger};
use ledger_base::rejection::Code;
use ledger_identity::key::KeyKind;

/// A world, and people whose certificates its ledgers get to know.
struct Crowd {
    world: World,
    people: Vec<User>,
    introductions: Vec<Transaction>,
}

impl Crowd {
    fn new() -> Self {
        let world = World::new();
        let kinds = [KeyKind::Ed25519, KeyKind::P256, KeyKind::Ed25519];
        let people: Vec<_> =
            (0..).zip(kinds).map(|(number, kind)| world.org1.user(&format!("user{number}"), "member", kind)).collect();
        let introductions =
            people.iter().map(|user| user.sign(&user.body(world.network, "put", &["k", "v"]))).collect();
        Self { world, people, introductions }
    }

    fn ledger(&self) -> Ledger {
        let ledger = self.world.ledger();
        let introductions: Vec<_> = self.introductions.iter().collect();
        assert_eq!(codes(&block(&ledger, NOW, &introductions)), [Code::Ok; 3]);
        ledger
    }

    /// So many calls, of which those at `forged` are signed by somebody else.
    fn calls(&self, count: usize, forged: &[usize]) -> Vec<Transaction> {
        let call = |number: usize| {
            let (user, other) = (&self.people[number % 3], &self.people[(number + 1) % 3]);
            let body = user.body(self.world.network, "put", &["k", &number.to_string()]);
            let signer = if forged.contains(&number) { other } else { user };
            Transaction::sign(&body, &signer.key).unwrap()
        };
        (0..count).map(call).collect()
    }
}

#[test]
fn forged_transactions_among_many_are_refused_and_no_others() {
    let crowd = Crowd::new();
    let (cold, warm) = (crowd.ledger(), crowd.ledger());
    // None; one; one in several of the groups that are checked together; all.
    let all: Vec<_> = (0..200).collect();
    for (height, forged) in (1..).zip([&[][..], &[77], &[0, 1, 99, 150, 199], &all]) {
        let calls = crowd.calls(200, forged);
        // What one node has checked before, in other company, changes nothing.
        warm.verify_together(calls[50..120].iter(), NOW);
        let entry = entry(&cold, NOW + height, &calls.iter().collect::<Vec<_>>());
        let (a, b) = (cold.apply(&entry).unwrap(), warm.apply(&entry).unwrap());
        assert_eq!(a, b);
        for (number, code) in codes(&a).into_iter().enumerate() {
            let wanted = if forged.contains(&number) { Code::BadSignature } else { Code::Ok };
            assert_eq!(code, wanted, "{number} of {forged:?}");
        }
    }
    assert_eq!(cold.tip(), warm.tip());
}

#[test]
fn what_was_checked_together_is_admitted_as_if_it_was_not() {
    let crowd = Crowd::new();
    let ledger = crowd.ledger();
    for forged in [&[][..], &[4, 10]] {
        let calls = crowd.calls(20, forged);
        ledger.verify_together(calls.iter(), NOW);
        for (number, call) in calls.iter().enumerate() {
            match ledger.admit(call.encoded().clone(), NOW) {
                Ok(Admission::New(_)) => assert!(!forged.contains(&number), "{number}"),
                Ok(Admission::Known(..)) => panic!("nothing was executed"),
                Err(refusal) => {
                    assert!(forged.contains(&number), "{number}");
                    assert_eq!((refusal.rejection.code, refusal.who), (Code::BadSignature, None));
                }
            }
        }
    }
}

#[test]
fn blocks_whose_signatures_were_checked_together_give_the_same_results() {
    let crowd = Crowd::new();
    let (cold, warm) = (crowd.ledger(), crowd.ledger());
    let mut outcomes = Vec::new();
    let entries: Vec<_> = [&[][..], &[1], &[0, 2], &[0, 1, 2]]
        .into_iter()
        .zip(1..)
        .map(|(forged, after)| {
            let calls = crowd.calls(3, forged);
            let mut entry = entry(&cold, NOW + after, &calls.iter().collect::<Vec<_>>());
            if after == 3 {
                entry.data = vec![0xff; 100].into();
            }
            outcomes.push(cold.apply(&entry).unwrap());
            entry
        })
        .collect();
    warm.verify_blocks(&entries);
    let again: Vec<_> = entries.iter().map(|entry| warm.apply(entry).unwrap()).collect();
    assert_eq!(outcomes, again);
    assert_eq!(codes(&again[1]), [Code::Ok, Code::BadSignature, Code::Ok]);
    assert_eq!(codes(&again[3]), [Code::BadSignature; 3]);
}
