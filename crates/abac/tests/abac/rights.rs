//! Rights that a policy must name, and the right to stop by rule.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, camera, farhad, identity, owner, robot, salma};
use ledger_abac::{Acquired, Ask, Can, EmergencyAnswer, PolicyCheck};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};
use proptest::prelude::*;

/// Every use of services; each fits a permit without a named right.
const OPEN: [&str; 4] = [
    "permit (principal, action, resource);",
    r#"permit (principal, action in [Action::"acquire", Action::"publish", Action::"subscribe"], resource);"#,
    r#"permit (principal in Organisation::"Org1", action, resource in Organisation::"Org2") unless { principal.name == "x" };"#,
    r#"permit (principal, action, resource in Robot::"Turtlebot4") when { principal.organisation != "Org9" };"#,
];
const RIGHTS: [&str; 4] = ["override", "confirm", "stop", "resume"];

/// A member of Org1 with no attribute.
fn guest() -> Identity {
    identity("Org1", "Guest", Role::Member, &[], 60)
}

fn turtlebot() -> Identity {
    identity("Org2", "Turtlebot4", Role::Robot, &[], 61)
}

fn under(policies: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "p", policies]);
    fleet
}

fn may(fleet: &mut Fleet, who: &Identity, action: &str) -> Can {
    let service = if ["stop", "resume"].contains(&action) { "Turtlebot4" } else { TURTLEBOT };
    let ask = Ask { who: None, action: action.to_owned(), service: service.to_owned(), ..Ask::default() };
    fleet.get(who, "can", &[&serde_json::to_string(&ask).unwrap()])
}

/// Uses a right with a call of the contract, while Salma waits to be confirmed for the Husky.
fn call(fleet: &Fleet, who: &Identity, right: &str) -> Code {
    let (function, args): (&str, Vec<&str>) = match right {
        "override" => ("take", vec![TURTLEBOT, "mine"]),
        "confirm" => ("confirm", vec![HUSKY, "Org1/Salma"]),
        right => (right, vec!["Turtlebot4"]),
    };
    fleet.simulate(who, function, &crate::fleet::bytes(&args)).err().map_or(Code::Ok, |refused| refused.code)
}

/// The Husky wants a confirmation, and Salma has asked for it.
fn with_a_contender(policies: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[HUSKY, r#"{"sharing":{"confirm":1}}"#]);
    assert!(matches!(fleet.get(&salma(), "acquire", &[HUSKY]), Acquired::Pending { .. }));
    fleet.ok(&owner(), "policy", &["put", "p", policies]);
    fleet
}

#[test]
fn a_permit_that_names_no_action_gives_neither_override_nor_confirm_nor_stop_nor_resume() {
    for policies in OPEN {
        let mut fleet = with_a_contender(policies);
        assert!(may(&mut fleet, &guest(), "acquire").allowed, "{policies}");
        for right in RIGHTS {
            let no = may(&mut fleet, &guest(), right);
            assert!(!no.allowed && no.name == "DENIED_BY_POLICY", "{right} by {policies}: {no:?}");
            assert!(no.wanted.contains(&format!("a permit that names the action {right}")), "{no:?}");
            assert!(
                !no.wanted.contains("found") && !no.found.contains("wanted"),
                "each line has its own values: {no:?}"
            );
            assert_eq!(call(&fleet, &guest(), right), Code::DeniedByPolicy, "{right} by {policies}");
        }
        for right in RIGHTS {
            let yes = may(&mut fleet, &owner(), right);
            assert!(yes.allowed && yes.rule == "an admin of the owner", "{yes:?}");
        }
    }
}

#[test]
fn a_permit_gives_the_rights_that_its_scope_names_and_no_other() {
    for named in RIGHTS {
        for scope in [
            format!("action == Action::{named:?}"),
            format!("action in [Action::{named:?}, Action::\"subscribe\"]"),
            format!("action in Action::{named:?}"),
        ] {
            let policies = format!("permit (principal, action, resource); permit (principal, {scope}, resource);");
            let mut fleet = with_a_contender(&policies);
            for right in RIGHTS {
                let wanted = right == named;
                assert_eq!(may(&mut fleet, &guest(), right).allowed, wanted, "{right} by {scope}");
                assert_eq!(call(&fleet, &guest(), right) == Code::Ok, wanted, "{right} by {scope}");
            }
        }
    }
}

#[test]
fn a_condition_about_a_right_that_the_scope_does_not_name_is_rejected_with_its_place() {
    let mut fleet = Fleet::of_the_paper();
    for right in RIGHTS {
        for text in [
            format!("permit (principal, action, resource)\nwhen {{ action == Action::{right:?} }};"),
            format!(
                "permit (principal, action == Action::\"publish\", resource)\nunless {{ action == Action::{right:?} }};"
            ),
            format!("forbid (principal, action, resource)\nwhen {{ [Action::{right:?}].contains(action) }};"),
        ] {
            let refused = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &text]);
            assert!(refused.found.contains(&format!("a condition uses Action::{right:?}, but")), "{refused}");
            let PolicyCheck { faults, policies, .. } = fleet.get(&salma(), "check", &[&text]);
            assert_eq!((faults.len(), faults[0].line, policies.len()), (1, 2, 0), "{faults:?}");
        }
        let named = format!(
            "forbid (principal, action in [Action::\"acquire\", Action::{right:?}], resource) when {{ action != Action::{right:?} }};"
        );
        let PolicyCheck { faults, .. } = fleet.get(&salma(), "check", &[&named]);
        let fits = faults.iter().all(|fault| !fault.message.contains("a condition uses"));
        assert!(fits, "{faults:?}");
    }
}

#[test]
fn a_permit_without_a_named_action_is_about_services_and_not_about_a_robot() {
    let mut fleet = Fleet::of_the_paper();
    for resource in
        [r#"resource == Robot::"Husky""#, "resource is Robot", r#"resource is Robot in Organisation::"Org2""#]
    {
        let text = format!("permit (principal, action, {resource});");
        let refused = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &text]);
        assert!(refused.found.contains("the permit has no effect"), "{refused}");
        let named = format!("permit (principal, action == Action::\"stop\", {resource});");
        fleet.ok(&owner(), "policy", &["put", "p", &named]);
    }
}

#[test]
fn a_holder_of_a_command_service_and_the_robot_itself_stop_it_whatever_policies_permit() {
    let forbid = "forbid (principal, action, resource) when { context.time * 9223372036854775807 == 0 };";
    for policies in [
        r#"permit (principal == User::"Org1/Farhad", action, resource);"#.to_owned(),
        // An error in a policy about everything takes no stop away.
        format!("{forbid} // erring"),
    ] {
        let mut fleet = Fleet::of_the_paper();
        fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
        if policies.contains("erring") {
            assert_eq!(may(&mut fleet, &turtlebot(), "stop").rule, "the robot itself");
        } else {
            fleet.ok(&owner(), "policy", &["put", "p", &policies]);
            let yes = may(&mut fleet, &farhad(), "stop");
            assert_eq!(
                (yes.allowed, yes.rule.as_str(), yes.policies.len()),
                (true, "a holder of Turtlebot4/cmd_vel", 0)
            );
            assert!(!may(&mut fleet, &salma(), "stop").allowed, "she holds nothing");
            let stopped: EmergencyAnswer = fleet.get(&farhad(), "stop", &["Turtlebot4", "smoke"]);
            assert_eq!((stopped.robots.len(), stopped.ended.len()), (1, 1));
            fleet.refused(&farhad(), Code::DeniedByPolicy, "resume", &["Turtlebot4"]);
            fleet.refused(&farhad(), Code::DeniedByPolicy, "stop", &["Turtlebot4"]);
            fleet.refused(&farhad(), Code::DeniedByPolicy, "stop", &["Husky"]);
            fleet.ok(&owner(), "resume", &["Turtlebot4"]);
            fleet.ok(&owner(), "policy", &["put", "q", &policies.replace("Farhad", "Salma")]);
        }
        fleet.ok(&owner(), "policy", &["put", "q", forbid]);
        let yes = may(&mut fleet, &turtlebot(), "stop");
        assert_eq!((yes.allowed, yes.rule.as_str()), (true, "the robot itself"));
        fleet.ok(&turtlebot(), "stop", &["Turtlebot4"]);
        fleet.refused(&turtlebot(), Code::PolicyError, "resume", &["Turtlebot4"]);
        fleet.refused(&camera(), Code::PolicyError, "stop", &["Turtlebot4"]);
    }
}

#[test]
fn a_lease_that_is_over_and_a_feed_stop_nothing() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    assert!(may(&mut fleet, &farhad(), "stop").allowed);
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    assert!(!may(&mut fleet, &farhad(), "stop").allowed);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.time += 3600 * SECOND;
    fleet.tick();
    fleet.refused(&farhad(), Code::DeniedByPolicy, "stop", &["Turtlebot4"]);
    fleet.ok(&owner(), "policy", &["put", "p", "permit (principal, action, resource);"]);
    fleet.ok(&guest(), "acquire", &["OptiTrack/poses"]);
    fleet.refused(&guest(), Code::DeniedByPolicy, "stop", &["OptiTrack"]);
}

#[test]
fn only_a_forbid_that_names_stop_takes_it_from_holders_and_from_the_robot() {
    let all = "permit (principal, action, resource);";
    for (forbid, stops) in [
        ("", true),
        (r#"forbid (principal, action in [Action::"resume", Action::"subscribe"], resource);"#, true),
        (r#"forbid (principal, action, resource == Robot::"Turtlebot4");"#, true),
        (r#"forbid (principal, action, resource) when { resource is Robot };"#, true),
        (r#"forbid (principal, action == Action::"stop", resource) when { principal.name == "Nobody" };"#, true),
        (r#"forbid (principal, action == Action::"stop", resource) when { principal.name != "Nobody" };"#, false),
        (r#"forbid (principal, action in [Action::"stop"], resource in Organisation::"Org2");"#, false),
        // One that cannot be evaluated denies.
        (
            r#"forbid (principal, action == Action::"stop", resource) when { context.time * 9223372036854775807 == 0 };"#,
            false,
        ),
    ] {
        let mut fleet = under(&format!("{all}{forbid}"));
        fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
        for who in [farhad(), turtlebot()] {
            let can = may(&mut fleet, &who, "stop");
            assert_eq!((can.allowed, can.rule.is_empty()), (stops, !stops), "{forbid}: {can:?}");
            assert_eq!(call(&fleet, &who, "stop") == Code::Ok, stops, "{forbid}");
        }
        fleet.ok(&owner(), "stop", &["Turtlebot4"]);
    }
}

#[test]
fn settings_stay_with_the_owners_admins_whatever_policies_permit() {
    let mut all = RIGHTS.map(|right| format!("Action::{right:?}")).to_vec();
    all.extend(["acquire", "publish", "subscribe"].map(|action| format!("Action::{action:?}")));
    let mut fleet = under(&format!("permit (principal, action in [{}], resource);", all.join(", ")));
    let admin = identity("Org1", "admin", Role::Admin, &[], 3);
    for (function, args) in [
        ("configure", vec![TURTLEBOT, r#"{"lease_ms":5000}"#]),
        ("replace", vec![&*robot("Turtlebot4", "open")]),
        ("remove", vec!["Turtlebot4"]),
    ] {
        fleet.ok(&owner(), "stop", &["*"]);
        for who in [guest(), turtlebot(), admin.clone()] {
            let refused = fleet.simulate(&who, function, &crate::fleet::bytes(&args)).unwrap_err();
            assert!([Code::NotOwner, Code::NotAdmin].contains(&refused.code), "{function}: {refused}");
        }
    }
}

/// A permit that names none of the rights.
fn permit() -> impl Strategy<Value = String> {
    let principal = prop::sample::select(
        &[
            "principal",
            "principal is User",
            r#"principal == User::"Org1/Guest""#,
            r#"principal in Organisation::"Org1""#,
        ][..],
    );
    let actions = prop::sample::subsequence(vec!["acquire", "publish", "subscribe"], 0..=3);
    let resource = prop::sample::select(
        &[
            "resource",
            r#"resource in Robot::"Turtlebot4""#,
            r#"resource in Organisation::"Org2""#,
            "resource is Service",
            r#"resource == Service::"Turtlebot4/cmd_vel""#,
        ][..],
    );
    let condition = prop::sample::select(
        &[
            "",
            "when { true }",
            "unless { false }",
            "when { principal.role == \"member\" || context.time > 0 }",
            "when { principal has name }",
            "when { action == action }",
            "when { action != Action::\"subscribe\" }",
        ][..],
    );
    (principal, actions, resource, condition).prop_map(|(principal, actions, resource, condition)| {
        let actions: Vec<String> = actions.iter().map(|action| format!("Action::{action:?}")).collect();
        let action = match &actions[..] {
            [] => "action".to_owned(),
            [one] => format!("action == {one}"),
            several => format!("action in [{}]", several.join(", ")),
        };
        format!("permit ({principal}, {action}, {resource}) {condition};")
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn no_set_of_permits_gives_a_right_that_none_of_them_names(
        sets in prop::collection::vec(prop::collection::vec(permit(), 1..6), 1..4),
    ) {
        let mut fleet = with_a_contender(OPEN[0]);
        for set in &sets {
            let text = set.concat();
            // A set that Cedar finds at fault changes nothing: the one before stays.
            let _ = fleet.call(&owner(), "policy", &crate::fleet::bytes(&["put", "p", &text]));
            for right in RIGHTS {
                prop_assert!(!may(&mut fleet, &guest(), right).allowed, "{} by {}", right, text);
                prop_assert_eq!(call(&fleet, &guest(), right), Code::DeniedByPolicy, "{} by {}", right, text);
            }
        }
    }
}
