//! Bytes that are written and told: every version of the program must make them alike.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, bytes, farhad, identity, owner, robot, salma};
use ledger_abac::DEFAULT_POLICY;
use ledger_base::hash::Hash;
use ledger_identity::Role;

/// Every way in which the records change: robots, services, grants and their ends, messages, policies.
fn story() -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT, "5000"]);
    fleet.set(&salma(), TURTLEBOT, 1, 1, 3).unwrap();
    fleet.time += 2 * SECOND;
    fleet.set(&salma(), TURTLEBOT, 1, 4, 1).unwrap();
    fleet.ok(&salma(), "renew", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let again = identity("Org1", "Salma", Role::Member, &["Turtlebot4", "Husky"], 50);
    fleet.ok(&again, "acquire", &[HUSKY]);
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"open","lease_ms_max":20000,"lease_ms":4000}"#]);
    fleet.set(&farhad(), TURTLEBOT, 0, 7, 2).unwrap();
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.set(&farhad(), TURTLEBOT, 2, 9, 1).unwrap();
    fleet.ok(&owner(), "replace", &[&robot("Turtlebot4", "exclusive")]);
    fleet.set(&salma(), TURTLEBOT, 1, 5, 1).unwrap();
    fleet.ok(&owner(), "policy", &["put", "p", DEFAULT_POLICY]);
    fleet.ok(
        &owner(),
        "policy",
        &["put", "q", "forbid (principal, action, resource) when { principal.name == \"Salma\" };"],
    );
    fleet.ok(&owner(), "policy", &["remove", "q"]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.time += 60 * SECOND;
    fleet.tick();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.revoke(&farhad());
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&owner(), "release", &[TURTLEBOT]);
    fleet.call(&owner(), "setup", &bytes(&[&robot("Spot", "open")])).unwrap();
    fleet.ok(&owner(), "remove", &["Spot"]);
    fleet.remove_organisation("Org1");
    fleet
}

const OF_RULES_1: [&str; 2] = [
    "b129a9656a155a832d00b3e81cd68810442335a732f5832f6bbf66274c187839",
    "590d291df63e67812a1dfe512ffb0f3a2fbd5d4a83abe793838fc5aabe5cbf57",
];

#[test]
fn records_and_events_have_the_bytes_that_they_always_had() {
    assert_eq!(hashes(&story()), OF_RULES_1);
}

/// Hashes of all writes and of all events.
fn hashes(fleet: &Fleet) -> [String; 2] {
    let writes = fleet.writes.iter().flatten().map(|(key, value)| format!("{key:?} {value:?}\n")).collect::<String>();
    let events = fleet.events.iter().map(|event| format!("{event:?}\n")).collect::<String>();
    [writes, events].map(|text| Hash::of(&[text.as_bytes()]).to_string())
}
