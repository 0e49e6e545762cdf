#![expect(clippy::unwrap_used, reason = "tests")]

use super::*;
use ledger::{Environment, Meter, Registry, Rules};
use ledger_base::hash::Hash;
use ledger_identity::key::PublicKey;
use ledger_identity::{Identity, Role};
use ledger_storage::result::Event;
use ledger_storage::state::{MemoryState, Overlay};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Block time of every call, microseconds.
const NOW: u64 = 1_795_219_200_000_000;

/// Stands in for access control: knows one robot.
struct Robots;

impl Chaincode for Robots {
    fn name(&self) -> &'static str {
        "abac"
    }

    fn invoke(&self, _: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        assert_eq!(function, "robot");
        match args {
            [name] if &name[..] == b"Turtlebot4" => Ok(Bytes::new()),
            _ => Err(Rejection::new(Code::UnknownRobot, "no such robot")),
        }
    }
}

/// A state, and the chaincode on it; every call is a block.
struct World {
    registry: Registry,
    state: Arc<MemoryState>,
    events: Vec<Event>,
}

fn member(organisation: &str, name: &str) -> Identity {
    // Any key: nothing here verifies signatures.
    let spki = [&b"\x30\x2a\x30\x05\x06\x03\x2b\x65\x70\x03\x21\x00\x58"[..], &[0x66; 31]].concat();
    Identity {
        organisation: organisation.to_owned(),
        name: name.to_owned(),
        role: Role::Member,
        attributes: BTreeMap::new(),
        issuer: [1; 32],
        serial: vec![1],
        fingerprint: [2; 32],
        public_key: PublicKey::from_spki(&spki).unwrap(),
        valid_from: 0,
        not_before: 0,
        not_after: u64::MAX,
    }
}

impl World {
    fn new() -> Self {
        let mut registry = Registry::new();
        registry.install(Arc::new(Inventory)).unwrap();
        registry.install(Arc::new(Robots)).unwrap();
        Self { registry, state: Arc::default(), events: Vec::new() }
    }

    fn call(&mut self, who: &Identity, function: &str, args: &[&str]) -> Result<Bytes, Rejection> {
        let environment = Environment {
            registry: &self.registry,
            submitter: Some(who),
            network: Hash::ZERO,
            rules: Rules::NEWEST,
            height: 1,
            time: NOW,
            transaction: Hash::ZERO,
            executed: &|_, _| false,
            meter: &Meter::of_block(),
        };
        let args: Vec<_> = args.iter().map(|arg| Bytes::copy_from_slice(arg.as_bytes())).collect();
        let mut overlay = Overlay::new(self.state.clone());
        let answer = Registry::invoke(environment, &mut overlay, &mut self.events, NAME, function, &args);
        self.state.apply(&overlay.finish().unwrap());
        answer
    }

    fn found(&mut self, who: &Identity, item: &str) -> Find {
        stored(&self.call(who, "found", &["Turtlebot4", item, "1.5", "-2"]).unwrap()).unwrap()
    }

    fn list(&mut self) -> Vec<Find> {
        stored(&self.call(&member("Org2", "Reader"), "list", &[]).unwrap()).unwrap()
    }

    #[track_caller]
    fn refused(&mut self, who: &Identity, code: Code, function: &str, args: &[&str]) -> Rejection {
        let (before, told) = (self.list(), self.events.len());
        let rejection = self.call(who, function, args).unwrap_err();
        assert_eq!(rejection.code, code, "{rejection}");
        assert_eq!((self.list(), self.events.len()), (before, told), "a refused call changed something");
        rejection
    }
}

#[test]
fn what_was_found_can_be_read_by_its_number_and_in_the_list() {
    let (mut world, salma) = (World::new(), member("Org1", "Salma"));
    let pallet = world.found(&salma, "pallet");
    let expected = Find {
        id: 1,
        item: "pallet".into(),
        robot: "Turtlebot4".into(),
        x_mm: 1500,
        y_mm: -2000,
        organisation: "Org1".into(),
        reported_by: "Org1/Salma".into(),
        time: NOW,
    };
    assert_eq!(pallet, expected);
    let crate_ = world.found(&salma, "crate");
    assert_eq!(stored::<Find>(&world.call(&salma, "item", &["2"]).unwrap()).unwrap(), crate_);
    assert_eq!(world.list(), [pallet, crate_]);
}

#[test]
fn the_list_is_in_the_order_of_finding_beyond_nine() {
    let (mut world, salma) = (World::new(), member("Org1", "Salma"));
    for number in 1..=11 {
        world.found(&salma, &format!("item {number}"));
    }
    assert_eq!(world.list().iter().map(|find| find.id).collect::<Vec<_>>(), (1..=11).collect::<Vec<_>>());
}

#[test]
fn only_the_organisation_that_found_it_collects_it() {
    let (mut world, salma) = (World::new(), member("Org1", "Salma"));
    world.found(&salma, "pallet");
    let refusal = world.refused(&member("Org2", "Farhad"), Code::Refused, "collected", &["1"]);
    assert_eq!((&*refusal.found, &*refusal.wanted), ("Org2/Farhad", "somebody of Org1"));
    world.call(&member("Org1", "Sara"), "collected", &["1"]).unwrap();
    assert_eq!(world.list(), []);
    world.refused(&salma, Code::NotFound, "collected", &["1"]);
}

#[test]
fn a_number_is_never_given_twice() {
    let (mut world, salma) = (World::new(), member("Org1", "Salma"));
    world.found(&salma, "pallet");
    world.call(&salma, "collected", &["1"]).unwrap();
    assert_eq!(world.found(&salma, "pallet").id, 2);
}

#[test]
fn subscribers_hear_of_finds_and_collections() {
    let (mut world, salma) = (World::new(), member("Org1", "Salma"));
    let pallet = world.found(&salma, "pallet");
    world.call(&salma, "collected", &["1"]).unwrap();
    let told: Vec<_> = world.events.iter().map(|event| (&*event.name, &*event.subject)).collect();
    assert_eq!(told, [("found", "pallet"), ("collected", "pallet")]);
    for event in &world.events {
        assert_eq!(stored::<Find>(&event.payload).unwrap(), pallet);
    }
}

#[test]
fn a_find_of_an_unknown_robot_is_refused_in_the_words_of_access_control() {
    let refusal =
        World::new().refused(&member("Org1", "Salma"), Code::UnknownRobot, "found", &["Nobody", "pallet", "0", "0"]);
    assert_eq!(refusal.message, "no such robot");
}

#[test]
fn a_wrong_argument_is_refused_by_name() {
    let (mut world, salma) = (World::new(), member("Org1", "Salma"));
    let long = "x".repeat(ITEM_BYTES_MAX + 1);
    for (name, args) in [
        ("ITEM", ["Turtlebot4", "", "0", "0"]),
        ("ITEM", ["Turtlebot4", &long, "0", "0"]),
        ("X", ["Turtlebot4", "pallet", "left", "0"]),
        ("X", ["Turtlebot4", "pallet", "NaN", "0"]),
        ("X", ["Turtlebot4", "pallet", "inf", "0"]),
        ("Y", ["Turtlebot4", "pallet", "0", "-100000.1"]),
    ] {
        let refusal = world.refused(&salma, Code::BadArgument, "found", &args);
        assert_eq!(refusal.message, format!("argument {name} is not usable"));
    }
    world.refused(&salma, Code::BadArgument, "item", &["-1"]);
    for (function, args) in [("found", &["Turtlebot4"][..]), ("collected", &[]), ("item", &[]), ("list", &["all"])] {
        let refusal = world.refused(&salma, Code::BadArgument, function, args);
        assert!(refusal.wanted.starts_with(function), "{refusal}");
    }
    world.refused(&salma, Code::UnknownFunction, "lost", &[]);
}

#[test]
fn a_full_inventory_says_how_to_make_room() {
    let (mut world, salma) = (World::new(), member("Org1", "Salma"));
    for _ in 0..FINDS_MAX {
        world.found(&salma, "pallet");
    }
    let refusal = world.refused(&salma, Code::LimitExceeded, "found", &["Turtlebot4", "pallet", "0", "0"]);
    assert!(refusal.advice().contains("collected"), "{refusal}");
    world.call(&salma, "collected", &["500"]).unwrap();
    world.found(&salma, "pallet");
}

#[test]
fn the_same_calls_give_the_same_state_and_events_everywhere() {
    let run = || {
        let mut world = World::new();
        world.found(&member("Org1", "Salma"), "pallet");
        world.found(&member("Org2", "Farhad"), "crate");
        world.call(&member("Org1", "Salma"), "collected", &["1"]).unwrap();
        (ledger_storage::state::StateRead::range(&*world.state, b"", None, usize::MAX).unwrap(), world.events)
    };
    assert_eq!(run(), run());
}
