//! That few policies are looked at, and that this changes nothing.
#![expect(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::asked::uid;
use super::{
    Engine, Hash, Index, Parsed, Permit, Question, Rejection, Resource, Texts, User, Verdict, decide, evaluate,
    parse_all,
};
use cedar_policy::{Policy, PolicySet};
use proptest::prelude::*;
use std::collections::BTreeMap;

fn question(user: &str, robot: &str, action: &'static str) -> Question {
    let texts = [("topic", "/cmd_vel"), ("type", "geometry_msgs/msg/Twist"), ("mode", "exclusive")];
    let more = [("direction", "command"), ("requiredAttribute", "A"), ("requiredValue", "true")];
    Question {
        version: Hash::ZERO,
        user: User {
            organisation: "Org1".to_owned(),
            name: user.to_owned(),
            role: "member",
            attributes: BTreeMap::from([("A".to_owned(), "true".to_owned())]),
        },
        action,
        by_rule: false,
        resource: Resource {
            service: Some((
                format!("{robot}/cmd_vel"),
                texts.into_iter().chain(more).map(|(key, value)| (key, value.to_owned())).collect(),
            )),
            robot: robot.to_owned(),
            owner: "Org2".to_owned(),
            trusted: vec!["Org1".to_owned()],
            of_robot: Vec::new(),
            own: Default::default(),
        },
        time_ms: 0,
    }
}

/// The verdict of these policies, which say nothing besides.
fn permit(policies: &[&str]) -> Verdict {
    let policies = policies.iter().map(|id| (*id).to_owned()).collect();
    Verdict::Permit(Permit { policies, ..Permit::default() })
}

/// The policies in one set.
fn unordered(texts: &Texts) -> PolicySet {
    let mut all = PolicySet::new();
    for (id, text) in texts {
        let set: PolicySet = text.parse().unwrap();
        for policy in set.policies() {
            all.add(policy.new_id(cedar_policy::PolicyId::new(id))).unwrap();
        }
    }
    all
}

/// Conditions of policies; the last one fails when it is evaluated.
const CONDITIONS: [&str; 4] =
    ["true", "principal.hasTag(\"A\")", "principal.name == \"Salma\"", "principal.getTag(\"B\") == \"x\""];

fn scope(kind: &'static str, entities: &'static [&'static str]) -> impl Strategy<Value = String> {
    let types = if kind == "principal" { "User" } else { "Service" };
    let named = prop::sample::select(entities);
    prop_oneof![
        Just(kind.to_owned()),
        Just(format!("{kind} is {types}")),
        named.clone().prop_map(move |entity| format!("{kind} == {entity}")),
        named.clone().prop_map(move |entity| format!("{kind} in {entity}")),
        named.prop_map(move |entity| format!("{kind} is {types} in {entity}")),
    ]
}

fn policies() -> impl Strategy<Value = Texts> {
    let users = &["User::\"Org1/Salma\"", "User::\"Org1/Farhad\"", "Organisation::\"Org1\"", "Organisation::\"Org2\""];
    let places =
        &["Service::\"T/cmd_vel\"", "Service::\"H/cmd_vel\"", "Robot::\"T\"", "Robot::\"H\"", "Organisation::\"Org2\""];
    let condition = prop::sample::select(&CONDITIONS[..]);
    let effect = prop::sample::select(&["permit", "permit", "permit", "forbid"][..]);
    let policy = (effect, scope("principal", users), scope("resource", places), condition);
    prop::collection::vec(policy, 0..12).prop_map(|policies| {
        let text = |(effect, principal, resource, condition)| {
            format!("{effect} ({principal}, action, {resource}) when {{ {condition} }};")
        };
        (0..).zip(policies).map(|(number, policy)| (format!("p{number}"), text(policy))).collect()
    })
}

proptest! {
    #[test]
    fn looking_at_candidates_only_changes_no_decision(texts in policies()) {
        let indexed = parse_all(&texts);
        let all = Parsed { policies: Ok(Index::of_all(unordered(&texts))), timeless: true, of_required: false, bytes: 0 };
        for user in ["Salma", "Farhad", "Nobody"] {
            for robot in ["T", "H", "U"] {
                let question = question(user, robot, "publish");
                prop_assert_eq!(decide(&indexed, &question).verdict, decide(&all, &question).verdict);
            }
        }
    }
}

#[test]
fn policies_about_other_robots_and_other_people_are_not_looked_at() {
    let mut index = Index::default();
    let mut add = |id: String, scope: &str| {
        let text = format!("permit ({scope});");
        index.add(Policy::parse(Some(cedar_policy::PolicyId::new(id)), text).unwrap()).unwrap();
    };
    for number in 0..500 {
        add(format!("r{number}"), &format!("principal, action, resource == Service::\"R{number}/cmd_vel\""));
        add(format!("u{number}"), &format!("principal == User::\"Org1/U{number}\", action, resource"));
    }
    add("general".to_owned(), "principal, action, resource");
    let entities = [("User", "Org1/U7"), ("Organisation", "Org1"), ("Service", "R7/cmd_vel"), ("Robot", "R7")];
    let [user, home, service, robot] = entities.map(|(kind, id)| uid(kind, id).unwrap());
    let (principals, resources) = ([user, home], [service, robot]);
    let asked = question("U7", "R7", "publish");
    let found = index.candidates(&asked, &principals, &resources).flat_map(PolicySet::policies);
    let mut found: Vec<String> = found.map(|policy| policy.id().to_string()).collect();
    found.sort();
    assert_eq!(found, ["general", "r7", "u7"]);
    assert_eq!(evaluate(&index, &asked), Ok(permit(&["general", "r7", "u7"])));
}

#[test]
fn texts_are_read_only_for_a_set_that_is_not_known() {
    let engine = Engine::start().unwrap();
    let texts = || Ok(vec![("p".to_owned(), "permit (principal, action, resource);".to_owned())]);
    let unread = || -> Result<Texts, Rejection> { panic!("the set is known") };
    assert_eq!(engine.decide(question("Salma", "T", "publish"), texts).unwrap().verdict, permit(&["p"]));
    assert_eq!(engine.decide(question("Farhad", "H", "acquire"), unread).unwrap().verdict, permit(&["p"]));
}
