//! Attributes of robots and services: typed facts by which policies speak of capabilities and not of names.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, farhad, owner, robot, salma};
use ledger_abac::{Attribute, RobotAsset, RobotChange};
use ledger_base::rejection::Code;

const CRANE: &str = r#"{"attributes":{"kind":"crane","payload_kg":20,"zones":["b","a","b"]}}"#;
/// Cranes that lift at most 50 kg, in zone a.
const SMALL_CRANES: &str = r#"permit (principal, action, resource) when {
    resource.hasTag("kind") && resource.getTag("kind") has text && resource.getTag("kind").text == "crane" &&
    resource.hasTag("payload_kg") && resource.getTag("payload_kg") has number &&
    resource.getTag("payload_kg").number <= 50 &&
    resource.hasTag("zones") && resource.getTag("zones") has set && resource.getTag("zones").set.contains("a") };"#;

#[test]
fn policies_speak_of_the_attributes_of_a_robot() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "cranes", SMALL_CRANES]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    fleet.ok(&owner(), "configure", &["Husky", CRANE]);
    fleet.ok(&farhad(), "acquire", &[HUSKY]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[TURTLEBOT]);
    // A grant that the new attributes no longer permit ends with them.
    let changed: RobotChange = fleet.get(&owner(), "configure", &["Husky", r#"{"attributes":{"payload_kg":75}}"#]);
    let told: Vec<_> =
        changed.changed.iter().map(|c| (c.setting.as_str(), c.before.as_str(), c.after.as_str())).collect();
    assert_eq!(told, [("attribute payload_kg", "20", "75")]);
    assert_eq!(changed.ended.iter().map(|ended| ended.reason.word()).collect::<Vec<_>>(), ["policy"]);
}

#[test]
fn an_attribute_of_a_service_takes_the_place_of_the_one_of_its_robot() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "cranes", SMALL_CRANES]);
    fleet.ok(&owner(), "configure", &["Husky", CRANE]);
    fleet.ok(&owner(), "configure", &[HUSKY, r#"{"attributes":{"zones":["c"]}}"#]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Husky"]);
    assert_eq!(asset.attributes["zones"], Attribute::Set(vec!["a".into(), "b".into()]), "sorted, each once");
    assert_eq!(asset.services[0].attributes["zones"], Attribute::Set(vec!["c".into()]));
    fleet.ok(&owner(), "configure", &[HUSKY, r#"{"attributes":{"zones":null}}"#]);
    fleet.ok(&farhad(), "acquire", &[HUSKY]);
}

#[test]
fn a_policy_that_asks_for_another_type_is_refused_or_finds_nothing() {
    let mut fleet = Fleet::of_the_paper();
    let untyped = r#"permit (principal, action, resource) when {
        resource.hasTag("kind") && resource.getTag("kind") has text && resource.getTag("kind").text == 7 };"#;
    fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", untyped]);
    let unasked = r#"permit (principal, action, resource) when { resource.getTag("kind").text == "crane" };"#;
    fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", unasked]);
    fleet.ok(&owner(), "policy", &["put", "cranes", SMALL_CRANES]);
    let text = r#"{"attributes":{"kind":"crane","payload_kg":"20","zones":["a"]}}"#;
    fleet.ok(&owner(), "configure", &["Husky", text]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
}

#[test]
fn a_robot_is_registered_with_its_attributes_and_replaced_without() {
    let mut fleet = Fleet::of_the_paper();
    let with = robot("Spot", "exclusive").replacen('{', r#"{"attributes":{"kind":"dog"},"#, 1);
    fleet.ok(&owner(), "setup", &[&with]);
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Spot"]);
    assert_eq!(asset.attributes["kind"], Attribute::Text("dog".into()));
    let replaced: Vec<RobotChange> = fleet.get(&owner(), "replace", &[&robot("Spot", "exclusive")]);
    assert!(replaced[0].robot.attributes.is_empty());
    assert_eq!(replaced[0].changed[0].before, "\"dog\"");
}

#[test]
fn names_values_and_their_sum_are_bounded() {
    let mut fleet = Fleet::of_the_paper();
    let long = "x".repeat(257);
    let set: Vec<String> = (0..65).map(|number| number.to_string()).collect();
    let many: Vec<String> = (0..16).map(|number| format!(r#""a{number}":"{}""#, "x".repeat(256))).collect();
    for (code, attributes) in [
        (Code::BadName, r#"{"":1}"#.to_owned()),
        (Code::BadName, r#"{"pay load":1}"#.to_owned()),
        (Code::BadName, format!(r#"{{"{}":1}}"#, "n".repeat(65))),
        (Code::BadArgument, r#"{"a":1.5}"#.to_owned()),
        (Code::BadArgument, r#"{"a":true}"#.to_owned()),
        (Code::BadArgument, format!(r#"{{"a":"{long}"}}"#)),
        (Code::BadArgument, r#"{"a":"\u0000"}"#.to_owned()),
        (Code::BadArgument, format!(r#"{{"a":{}}}"#, serde_json::to_string(&set).unwrap())),
        (Code::LimitExceeded, format!("{{{}}}", many.join(","))),
        (Code::NotFound, r#"{"unknown":null}"#.to_owned()),
    ] {
        fleet.refused(&owner(), code, "configure", &["Husky", &format!(r#"{{"attributes":{attributes}}}"#)]);
    }
    let of_service = format!("{{{}}}", many[..4].join(","));
    fleet.refused(&owner(), Code::LimitExceeded, "configure", &[HUSKY, &format!(r#"{{"attributes":{of_service}}}"#)]);
    fleet.ok(&owner(), "configure", &["Husky", &format!(r#"{{"attributes":{of_service}}}"#)]);
}
