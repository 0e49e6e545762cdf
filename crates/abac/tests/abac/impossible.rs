//! Policies that no network can satisfy are rejected, and names that are unknown today are listed.

use crate::fleet::{Fleet, farhad, owner, salma};
use ledger_abac::PolicyCheck;
use ledger_base::rejection::Code;
use ledger_identity::Identity;

fn when(condition: &str) -> String {
    format!("permit (principal, action, resource is Service)\nwhen {{ {condition} }};")
}

#[test]
fn what_no_network_can_satisfy_is_rejected_with_its_place_and_the_form_that_is_wanted() {
    let mut fleet = Fleet::of_the_paper();
    for (text, line, part) in [
        (r#"forbid (principal == User::"Farhad", action, resource);"#.to_owned(), 1, r#"User::"ORGANISATION/NAME""#),
        (r#"forbid (principal in User::"Org1/", action, resource);"#.to_owned(), 1, r#"User::"ORGANISATION/NAME""#),
        (
            when(r#"[User::"Org1/Salma", User::"Farhad"].contains(principal)"#),
            2,
            r#"no network can have User::"Farhad""#,
        ),
        (r#"permit (principal in Organisation::"Org1/Salma", action, resource);"#.to_owned(), 1, "Organisation::"),
        (r#"permit (principal, action, resource in Robot::"Husky/cmd_vel");"#.to_owned(), 1, r#"Robot::"ROBOT""#),
        (r#"permit (principal, action, resource == Service::"Husky");"#.to_owned(), 1, r#"Service::"ROBOT/TOPIC""#),
        (when("principal has level"), 2, r#"principal.hasTag("level")"#),
        (when(r#"principal has level && principal.level == "3""#), 2, r#"principal.hasTag("level")"#),
        (
            r#"forbid (principal, action, resource) unless { principal has level };"#.to_owned(),
            1,
            "never has the attribute",
        ),
        (when("context has speed"), 2, "the only attribute of context"),
        (when("resource has zones"), 2, r#"resource.hasTag("zones")"#),
        (when(r#"principal.role == "administrator""#), 2, "one of member, admin, node, robot"),
        (when(r#"["admin", "owner"].contains(principal.role)"#), 2, "one of member, admin, node, robot"),
        (when(r#"principal.name == "Org1/Salma""#), 2, "a name without its organisation"),
        (when(r#""Org/1" == principal.organisation"#), 2, "the name of an organisation"),
        (when(r#"resource.owner == """#), 2, "the name of an organisation"),
        (when(r#"resource.robot == "Husky/cmd_vel""#), 2, "the name of a robot"),
        (when(r#"resource.topic == "cmd_vel""#), 2, "begins with"),
        (when(r#"resource.direction != "commands""#), 2, "command or feed"),
        (when(r#"principal.name == "Salma" && false"#), 1, "impossible"),
        (r#"permit (principal in Robot::"Husky", action, resource);"#.to_owned(), 1, "impossible"),
    ] {
        let PolicyCheck { faults, policies, unknown } = fleet.get(&salma(), "check", &[&text]);
        assert!(policies.is_empty() && unknown.is_empty(), "{text}");
        assert!(faults.iter().any(|fault| fault.message.contains(part) && fault.line == line), "{text}: {faults:?}");
        let refused = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &text]);
        assert!(refused.found.contains(part), "{text}: {refused}");
    }
}

#[test]
fn conditions_that_a_network_can_satisfy_some_day_are_accepted() {
    let mut fleet = Fleet::of_the_paper();
    for text in [
        r#"forbid (principal == User::"Org7/Some Body", action, resource);"#.to_owned(),
        r#"permit (principal in Organisation::"Org7", action, resource in Robot::"Spot-2.b");"#.to_owned(),
        r#"permit (principal, action, resource == Service::"Spot/arm/cmd");"#.to_owned(),
        when(r#"principal has name && resource has topic && context has time && principal.role == "node""#),
        when(r#"resource.topic == "/cmd_vel" && resource.direction == "command" && principal.name != "Salma""#),
        when(r#"principal.hasTag("level") && principal.getTag("level") == "a/b""#),
        when("resource.mode == \"auction\" || resource.type == \"x\""),
    ] {
        let PolicyCheck { faults, .. } = fleet.get(&salma(), "check", &[&text]);
        assert!(faults.is_empty(), "{text}: {faults:?}");
    }
}

#[test]
fn names_that_the_network_does_not_know_today_are_listed_and_do_not_keep_a_policy_out() {
    let mut fleet = Fleet::of_the_paper();
    let text = r#"permit (principal == User::"Org1/Salma", action, resource in Robot::"Turtelbot4");
        forbid (principal == User::"Org1/Late", action, resource == Service::"Husky/cmd_val");
        permit (principal in Organisation::"Org7", action, resource) when {
            principal.organisation == "Org1" || principal.organisation == "Org8" || resource in Robot::"Husky"
        };"#;
    let PolicyCheck { faults, policies, unknown } = fleet.get(&farhad(), "check", &[text]);
    assert_eq!((faults.len(), policies.len()), (0, 3), "{faults:?}");
    let told: Vec<_> = unknown.iter().map(|name| (name.line, name.kind.as_str(), name.name.as_str())).collect();
    assert_eq!(
        told,
        [
            (1, "Robot", "Turtelbot4"),
            (2, "Service", "Husky/cmd_val"),
            (2, "User", "Org1/Late"),
            (3, "Organisation", "Org7"),
            (3, "Organisation", "Org8"),
        ]
    );
    assert_eq!(unknown[0].near, "did you mean \"Turtlebot4\"?");
    assert_eq!(unknown[1].near, "did you mean \"Husky/cmd_vel\"?");
    // The ledger takes it all the same: who sets it up is asked, a rollback is not.
    fleet.ok(&owner(), "policy", &["put", "p", text]);
}

#[test]
fn a_policy_that_applies_to_nobody_of_today_is_marked() {
    let mut fleet = Fleet::of_the_paper();
    let text = r#"permit (principal, action, resource) when { principal.hasTag("Turtlebot4") };
        forbid (principal, action == Action::"acquire", resource) when { principal.hasTag("levle") };
        permit (principal in Organisation::"Org1", action == Action::"stop", resource == Robot::"Husky");
        permit (principal == User::"Org1/Farhad", action == Action::"publish", resource) when { context.time < 5 };"#;
    let unmatched = |fleet: &mut Fleet, who: &Identity| -> Vec<bool> {
        let PolicyCheck { policies, .. } = fleet.get(who, "check", &[text]);
        policies.iter().map(|policy| policy.unmatched).collect()
    };
    assert_eq!(unmatched(&mut fleet, &owner()), [false; 4], "the ledger knows nobody");
    *fleet.members.2.lock().unwrap() = vec!["Org1/Salma", "Org1/Farhad"];
    assert_eq!(unmatched(&mut fleet, &owner()), [false, true, false, true]);
    assert_eq!(unmatched(&mut fleet, &salma()), [false; 4], "Org1 has no robots");
}
