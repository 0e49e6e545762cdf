//! The properties that hold after any sequence of calls.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, TWIST, admin1, bytes, farhad, identity, owner, robot, salma};
use bytes::Bytes;
use ledger_abac::{DEFAULT_POLICY, Grant};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// One block: somebody calls, something expires, or somebody is revoked.
#[derive(Clone, Debug)]
enum Step {
    Call(usize, &'static str, Vec<String>),
    Set { who: usize, service: &'static str, epoch: u64, seq: u64 },
    Wait(u64),
    Revoke(usize),
}

fn people() -> Vec<Identity> {
    let again = identity("Org1", "Salma", Role::Member, &["Turtlebot4", "Husky"], 50);
    vec![salma(), farhad(), admin1(), owner(), again]
}

fn step() -> impl Strategy<Value = Step> {
    let who = 0..people().len();
    let service = prop_oneof![Just(TURTLEBOT), Just(HUSKY), Just("Spot/cmd_vel")];
    let call =
        (who.clone(), prop_oneof![4 => Just("acquire"), 1 => Just("renew"), 2 => Just("release")], service.clone())
            .prop_map(|(who, function, service)| Step::Call(who, function, vec![service.to_owned()]));
    let setup = (prop_oneof![Just("Turtlebot4"), Just("Husky")], prop_oneof![Just("open"), Just("exclusive")])
        .prop_map(|(name, mode)| Step::Call(3, "replace", vec![robot(name, mode)]));
    let policy = prop_oneof![
        Just(vec!["put".to_owned(), "p".to_owned(), DEFAULT_POLICY.to_owned()]),
        Just(vec!["put".to_owned(), "p".to_owned(), "permit (principal, action, resource);".to_owned()]),
        Just(vec![
            "put".to_owned(),
            "q".to_owned(),
            "forbid (principal, action, resource) when { principal.name == \"Farhad\" && context.time > 0 };"
                .to_owned()
        ]),
        Just(vec!["remove".to_owned(), "p".to_owned()]),
        Just(vec!["remove".to_owned(), "q".to_owned()]),
    ]
    .prop_map(|args| Step::Call(3, "policy", args));
    prop_oneof![
        8 => call,
        8 => (who.clone(), service, 0..6_u64, 0..20_u64)
            .prop_map(|(who, service, epoch, seq)| Step::Set { who, service, epoch, seq }),
        2 => (0..12_000_000_u64).prop_map(Step::Wait),
        1 => who.prop_map(Step::Revoke),
        1 => setup,
        1 => Just(Step::Call(3, "remove", vec!["Husky".to_owned()])),
        2 => policy,
    ]
}

fn play(fleet: &mut Fleet, people: &[Identity], step: &Step) -> Result<Bytes, Code> {
    match step {
        Step::Call(who, function, args) => {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            fleet.call(&people[*who], function, &bytes(&args)).map_err(|rejection| rejection.code)
        }
        Step::Set { who, service, epoch, seq } => {
            fleet.set(&people[*who], service, *epoch, *seq, 1).map_err(|rejection| rejection.code)
        }
        Step::Wait(micros) => {
            fleet.time += micros;
            fleet.tick();
            Ok(Bytes::new())
        }
        Step::Revoke(who) => {
            fleet.revoke(&people[*who]);
            Ok(Bytes::new())
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn an_exclusive_service_has_one_holder_at_every_height_and_epochs_only_grow(
        steps in prop::collection::vec(step(), 1..80),
    ) {
        let mut fleet = Fleet::of_the_paper();
        let people = people();
        let mut epochs: BTreeMap<String, u64> = BTreeMap::new();
        for step in &steps {
            let since = fleet.events.len();
            let outcome = play(&mut fleet, &people, step);
            prop_assert_ne!(outcome.clone(), Err(Code::ChaincodePanic));
            for event in fleet.events[since..].iter().filter(|event| event.name == "granted") {
                let grant: Grant = serde_json::from_slice(&event.payload).unwrap();
                let before = epochs.insert(grant.service.clone(), grant.epoch).unwrap_or(0);
                prop_assert!(grant.epoch == before + 1, "epoch {} after {before}", grant.epoch);
            }
            let grants: Vec<Grant> =
                serde_json::from_slice(&fleet.simulate(&owner(), "grants", &[]).unwrap()).unwrap();
            let mut exclusive = BTreeMap::new();
            for grant in grants {
                prop_assert!(grant.expires > fleet.time);
                if grant.mode == ledger_abac::Mode::EXCLUSIVE {
                    prop_assert!(exclusive.insert(grant.service, (grant.holder, grant.epoch)).is_none());
                }
            }
            // A message of an exclusive service is published by its holder only.
            if let (Step::Set { who, service, epoch, .. }, Ok(_)) = (step, outcome)
                && let Some(holder) = exclusive.get(*service)
            {
                prop_assert_eq!(holder, &(people[*who].id(), *epoch));
            }
        }
    }

    #[test]
    fn warm_caches_and_cold_ones_write_the_same(steps in prop::collection::vec(step(), 1..60)) {
        let (mut warm, mut cold) = (Fleet::of_the_paper(), Fleet::of_the_paper());
        let people = people();
        for (at, step) in steps.iter().enumerate() {
            // The warm one also simulates every call first, as a gateway does, and others that never come.
            if let Step::Call(who, function, args) = step {
                let args: Vec<&str> = args.iter().map(String::as_str).collect();
                let _ = warm.simulate(&people[*who], function, &bytes(&args));
            }
            let _ = warm.simulate(&owner(), "policy", &bytes(&["put", "p", "forbid (principal, action, resource);"]));
            let set = [&bytes(&[TURTLEBOT, "0", "0"])[..], &[Bytes::from_static(&TWIST)]].concat();
            let _ = warm.simulate(&people[at % people.len()], "set", &set);
            if at % 8 == 0 {
                cold.forget();
            }
            let outcomes = (play(&mut warm, &people, step), play(&mut cold, &people, step));
            prop_assert_eq!(outcomes.0, outcomes.1);
            prop_assert_eq!(warm.writes.last(), cold.writes.last());
            prop_assert_eq!(&warm.events, &cold.events);
        }
    }
}
