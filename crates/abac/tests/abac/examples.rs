//! The examples of docs/policies.md, each with its cases, and the schema that the page shows.

use crate::fleet::{Fleet, admin1, identity, owner};
use ledger_abac::{Ask, Can, DEFAULT_POLICY, PolicyCheck, PolicyText, SCHEMA};
use ledger_identity::{Identity, Role};
use std::collections::BTreeMap;

const PAGE: &str = include_str!("../../../../docs/policies.md");

/// The blocks of the page in that language, in order.
fn blocks<'p>(page: &'p str, language: &str) -> Vec<&'p str> {
    let start = format!("```{language}\n");
    let block = |rest: &'p str| rest.split_once("\n```").map(|(block, _)| block).unwrap();
    page.split(start.as_str()).skip(1).map(block).collect()
}

fn person(name: &str, attributes: &[(&str, &str)], serial: u8) -> Identity {
    let attributes = attributes.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
    Identity { attributes: attributes.collect::<BTreeMap<_, _>>(), ..identity("Org1", name, Role::Member, &[], serial) }
}

/// The people and robots of the page.
fn cast() -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    let yes = |key: &'static str| (key, "true");
    let salma = [yes("Turtlebot4"), yes("Husky"), ("level", "3"), ("zone", "yard"), yes("trained"), yes("safety")];
    *fleet.members.1.lock().unwrap() = vec![
        person("Salma", &salma, 21),
        person("Farhad", &[yes("Turtlebot4"), ("level", "2"), ("zone", "hall")], 22),
        person("Guest", &[yes("guest")], 23),
        admin1(),
        owner(),
        // As `ledgerd dev` calls them.
        identity("Org1", "Admin", Role::Admin, &[], 24),
        identity("Org2", "Admin", Role::Admin, &[], 25),
    ];
    for (robot, attributes) in [
        ("Turtlebot4", r#"{"kind":"rover","payload_kg":9,"zones":["hall","lab"]}"#),
        ("Husky", r#"{"kind":"rover","payload_kg":75,"zones":["yard","road"]}"#),
    ] {
        fleet.ok(&owner(), "configure", &[robot, &format!(r#"{{"attributes":{attributes}}}"#)]);
    }
    fleet
}

/// Runs the cases of an example; answers with those that went otherwise.
fn failing(fleet: &mut Fleet, policy: &str, cases: &str) -> Vec<String> {
    let mut policies = vec![PolicyText { id: "example".to_owned(), text: policy.to_owned() }];
    if policy.starts_with("// Beside the built-in policy") {
        policies.push(PolicyText { id: "default".to_owned(), text: DEFAULT_POLICY.to_owned() });
    }
    let cases: toml::Table = cases.parse().unwrap();
    let mut failing = Vec::new();
    for case in cases["case"].as_array().unwrap() {
        let text = |key: &str| case.get(key).map(|value| value.as_str().unwrap().to_owned());
        let at = text("at").map(|at| micros(&at));
        let (who, action, service) = (text("who"), text("action").unwrap(), text("service").unwrap());
        let ask = Ask { who, action, service, at, policies: Some(policies.clone()) };
        let can: Can = fleet.get(&owner(), "can", &[&serde_json::to_string(&ask).unwrap()]);
        let expected = match text("expect").unwrap().as_str() {
            "allow" => can.allowed,
            "deny" => !can.allowed,
            name => can.name == name,
        };
        if !expected {
            failing.push(format!("{case:?}: {can:?}"));
        }
    }
    failing
}

/// Microseconds since the UNIX epoch of a time of November or December 2026.
fn micros(rfc3339: &str) -> u64 {
    let number = |range: std::ops::Range<usize>| rfc3339[range].parse::<u64>().unwrap();
    assert_eq!(number(0..4), 2026);
    // The first of November 2026 is day 20758.
    let day = 20_758 + (number(5..7) - 11) * 30 + number(8..10) - 1;
    let seconds = day * 86_400 + number(11..13) * 3600 + number(14..16) * 60 + number(17..19);
    let offset = if rfc3339.ends_with('Z') { 0 } else { number(20..22) * 3600 };
    (seconds - offset) * 1_000_000
}

#[test]
fn the_twelve_examples_of_the_page_decide_as_it_says() {
    let mut fleet = cast();
    let examples: Vec<&str> = PAGE.split("\n### ").skip(1).collect();
    assert_eq!(examples.len(), 12);
    for example in examples {
        let title = example.lines().next().unwrap();
        let ([policy], [cases]) = (&blocks(example, "cedar")[..], &blocks(example, "toml")[..]) else {
            panic!("{title}: wanted one policy and its cases");
        };
        let PolicyCheck { faults, policies, .. } = fleet.get(&owner(), "check", &[policy]);
        assert!(faults.is_empty(), "{title}: {faults:?}");
        assert!(!policies.is_empty(), "{title}: no words");
        let open: Vec<_> =
            policies.iter().filter(|policy| policy.effect == "permit" && !policy.except.is_empty()).collect();
        assert!(open.is_empty(), "{title}: a permit names its actions: {open:?}");
        let failing = failing(&mut fleet, policy, cases);
        assert!(failing.is_empty(), "{title}: {failing:#?}");
        assert!(cases.matches("[[case]]").count() >= 2, "{title}: a yes and a no at least");
    }
}

#[test]
fn a_case_that_the_policy_decides_otherwise_is_noticed() {
    let mut fleet = cast();
    let example = PAGE.split("\n### ").nth(2).unwrap();
    let (policy, cases) = (blocks(example, "cedar")[0], blocks(example, "toml")[0]);
    assert!(!failing(&mut fleet, "permit (principal, action, resource);", cases).is_empty());
    assert!(!failing(&mut fleet, policy, &cases.replace("allow", "deny")).is_empty());
}

#[test]
fn the_page_shows_the_schema_that_policies_are_checked_against() {
    assert_eq!(blocks(PAGE, "cedarschema"), [SCHEMA.trim_end()]);
}

#[test]
fn the_page_names_every_annotation() {
    let mut fleet = cast();
    let PolicyCheck { faults, .. } = fleet.get(&owner(), "check", &["@x(\"\") permit (principal, action, resource);"]);
    let (_, known) = faults[0].message.split_once("wanted one of ").unwrap();
    assert!(known.split(", ").count() >= 8, "{known}");
    for name in known.split(", ") {
        assert!(PAGE.contains(&format!("`{name}(")), "{name}");
    }
}
