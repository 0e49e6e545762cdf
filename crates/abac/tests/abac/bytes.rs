//! Bytes that are written and told: every version of the program must make them alike.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, bytes, farhad, identity, owner, robot, salma};
use ledger::Rules;
use ledger_abac::default_policy;
use ledger_base::hash::Hash;
use ledger_identity::Role;

/// Every way in which the records change: robots, services, grants and their ends, messages, policies.
fn story(rules: Rules) -> Fleet {
    let mut fleet = Fleet::of_the_paper_under(rules);
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
    fleet.ok(&owner(), "policy", &["put", "p", default_policy(Rules::FIRST)]);
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

const OF_RULES_2: [&str; 2] = [
    "7d4913a4df1dd0a9a4b14548131ea22f2bfed74f738fb4206b2ceabba3be6778",
    "82a50de3ff171b82e01a9a975708dfcf5c6a4ee84207f9a3a4d1d4cb86f90043",
];
/// Robots have an index by owner, versions of policies their steps, and grants the policies that permitted them. Robots with
/// grants that are decided again are marked meanwhile, and the newest revocation is noted.
const OF_RULES_3: [&str; 2] = [
    "306ccf88a945ff0e72af0526c0e0b837759426d177af93763622b7e763c55009",
    "3822d3f1034d8d2cd86e3282ebc4bdb318f94c1ab1fd061d94ea5438086ed2e7",
];

#[test]
fn records_and_events_have_the_bytes_that_they_always_had() {
    for (rules, known) in [(Rules::FIRST, OF_RULES_2), (Rules::NEWEST, OF_RULES_3)] {
        assert_eq!(hashes(&story(rules)), known, "rules {rules}");
    }
}

/// Hashes of all writes and of all events.
fn hashes(fleet: &Fleet) -> [String; 2] {
    let writes = fleet.writes.iter().flatten().map(|(key, value)| format!("{key:?} {value:?}\n")).collect::<String>();
    let events = fleet.events.iter().map(|event| format!("{event:?}\n")).collect::<String>();
    [writes, events].map(|text| Hash::of(&[text.as_bytes()]).to_string())
}
