//! May somebody do something, and why: the answer names the condition that failed, what was found and what is wanted.

use crate::fleet::{Fleet, HUSKY, SECOND, START, TURTLEBOT, admin1, bytes, farhad, owner, salma};
use ledger::Page;
use ledger_abac::{Ask, Can, Could, DEFAULT_POLICY, PolicyChange, PolicyCheck, PolicyDiff, PolicyFault, PolicyText};
use ledger_base::rejection::Code;

fn ask(who: &str, action: &str, service: &str) -> Ask {
    Ask { who: Some(who.to_owned()), action: action.to_owned(), service: service.to_owned(), ..Ask::default() }
}

fn with(ask: Ask, text: &str) -> Ask {
    Ask { policies: Some(vec![PolicyText { id: "given".to_owned(), text: text.to_owned() }]), ..ask }
}

#[track_caller]
fn can(fleet: &mut Fleet, ask: &Ask) -> Can {
    fleet.get(&salma(), "can", &[&serde_json::to_string(ask).unwrap()])
}

/// Policy, found and wanted of every condition.
fn conditions(can: &Can) -> Vec<(&str, &str, &str)> {
    can.conditions.iter().map(|c| (c.policy.as_str(), c.found.as_str(), c.wanted.as_str())).collect()
}

#[test]
fn a_yes_names_the_policies_that_decided() {
    let mut fleet = Fleet::of_the_paper();
    let yes = can(&mut fleet, &ask("Org1/Salma", "acquire", HUSKY));
    assert!(yes.allowed && yes.conditions.is_empty(), "{yes:?}");
    assert_eq!((yes.code.as_str(), yes.policies), ("LGR-0000", vec!["default.policy0".to_owned()]));
}

#[test]
fn a_no_names_the_condition_that_failed_with_the_value_found_and_the_value_wanted() {
    let mut fleet = Fleet::of_the_paper();
    for (policy, wanted) in [
        (
            r#"permit (principal, action, resource) when { principal.role == "admin" };"#,
            (r#"principal.role is "member""#, r#"principal.role == "admin""#),
        ),
        (
            r#"permit (principal, action, resource) when { ["admin", "node"].contains(principal.role) };"#,
            (r#"principal.role is "member""#, r#"principal.role in ["admin", "node"]"#),
        ),
        (
            r#"permit (principal == User::"Org1/Salma", action, resource);"#,
            (r#"principal is User::"Org1/Farhad""#, r#"principal == User::"Org1/Salma""#),
        ),
        (
            r#"permit (principal in Organisation::"Org2", action, resource);"#,
            (r#"principal is User::"Org1/Farhad""#, r#"principal in Organisation::"Org2""#),
        ),
        (
            r#"permit (principal, action, resource) when { principal.hasTag("level") && principal.getTag("level") == "3" };"#,
            (r#"principal has no "level""#, r#"principal with "level""#),
        ),
        (
            r#"permit (principal, action, resource) when { principal.organisation == resource.owner };"#,
            (r#"principal.organisation is "Org1""#, r#"principal.organisation == "Org2""#),
        ),
        (
            r#"permit (principal, action, resource) unless { principal.name == "Farhad" };"#,
            (r#"principal.name is "Farhad""#, r#"!(principal.name == "Farhad")"#),
        ),
        (
            r#"permit (principal, action, resource) when { principal.name == "A" || principal.role like "a*" };"#,
            (
                r#"principal.name is "Farhad", principal.role is "member""#,
                r#"(principal.name == "A") || (principal.role like "a*")"#,
            ),
        ),
    ] {
        let no = can(&mut fleet, &with(ask("Org1/Farhad", "publish", TURTLEBOT), policy));
        assert!(!no.allowed, "{policy}");
        assert_eq!(conditions(&no), [("given", wanted.0, wanted.1)], "{policy}");
        assert_eq!((no.found.as_str(), no.code.as_str()), (wanted.0, "LGR-3002"), "{policy}");
    }
}

#[test]
fn the_nearest_policy_is_told_first_and_one_about_another_action_or_robot_is_not() {
    let mut fleet = Fleet::of_the_paper();
    let policies = r#"
        permit (principal, action == Action::"subscribe", resource) when { principal.role == "node" };
        permit (principal, action, resource in Robot::"Husky") when { principal.role == "node" };
        permit (principal, action, resource) when { principal.role == "robot" && principal.name == "x" };
        permit (principal, action, resource) when { principal.role == "admin" };"#;
    let no = can(&mut fleet, &with(ask("Org1/Farhad", "publish", TURTLEBOT), policies));
    let policies: Vec<&str> = no.conditions.iter().map(|failed| failed.policy.as_str()).collect();
    assert_eq!(policies, ["given.policy3", "given.policy2", "given.policy2"]);
}

#[test]
fn what_forbids_something_is_told_with_what_it_looked_at() {
    let mut fleet = Fleet::of_the_paper();
    let policies = r#"permit (principal, action, resource);
        forbid (principal, action, resource) when { principal.name == "Farhad" };"#;
    let no = can(&mut fleet, &with(ask("Org1/Farhad", "publish", TURTLEBOT), policies));
    assert_eq!(no.policies, ["given.policy1"]);
    assert_eq!(no.found, r#"forbidden by given.policy1, because principal.name is "Farhad""#);
}

#[test]
fn the_time_asked_about_counts() {
    let mut fleet = Fleet::of_the_paper();
    let window = r#"@between("08:00-18:00 Z") permit (principal, action, resource);"#;
    let at = |hours: u64| Ask { at: Some(START + hours * 3600 * SECOND), ..ask("Org1/Farhad", "publish", HUSKY) };
    assert!(can(&mut fleet, &with(at(9), window)).allowed);
    let no = can(&mut fleet, &with(at(19), window));
    assert_eq!(conditions(&no), [("given", "the time is 2026-11-21T19:00:00.000000Z", "a time within 08:00-18:00 Z")]);
    let until = format!("permit (principal, action, resource) when {{ context.time < {} }};", START / 1000);
    let no = can(&mut fleet, &with(at(1), &until));
    assert!(no.found.contains("context.time is") && no.found.contains("2026-11-21T01:00:00"), "{}", no.found);
}

#[test]
fn a_refusal_carries_the_same_explanation() {
    let mut fleet = Fleet::of_the_paper();
    let admins = r#"permit (principal, action, resource) when { principal.role == "admin" };"#;
    fleet.ok(&owner(), "policy", &["put", "admins", admins]);
    let no = can(&mut fleet, &ask("Org1/Salma", "acquire", HUSKY));
    let refused = fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    let warm = fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    assert_eq!(warm.to_string(), refused.to_string(), "remembered reasons are the same");
    assert_eq!((refused.advice(), &refused.found, &refused.wanted), (&*no.next, &no.found, &no.wanted));
    assert_eq!(no.found, r#"principal.role is "member""#);
    assert!(no.wanted.starts_with(r#"principal.role == "admin", as policy admins requires"#), "{}", no.wanted);
}

#[test]
fn a_refusal_by_a_policy_of_some_length_is_explained_as_well() {
    let mut fleet = Fleet::of_the_paper();
    let long = r#"permit (principal, action, resource is Service) when {
        resource.trusted.contains(principal.organisation) && principal.hasTag("trained") &&
        resource.hasTag("payload_kg") && resource.getTag("payload_kg") has number &&
        resource.getTag("payload_kg").number <= 50 };"#;
    fleet.ok(&owner(), "configure", &["Husky", r#"{"attributes":{"payload_kg":20}}"#]);
    fleet.ok(
        &owner(),
        "policy",
        &[
            "put",
            "admins",
            r#"permit (principal, action, resource) when { principal.role == "admin" && principal.name == "x" };"#,
        ],
    );
    fleet.ok(&owner(), "policy", &["put", "trained", long]);
    let refused = fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    assert_eq!(refused.found, r#"principal has no "trained""#);
}

#[test]
fn the_answer_is_that_of_the_call_itself() {
    let mut fleet = Fleet::of_the_paper();
    for who in [salma(), farhad(), admin1(), owner()] {
        for service in [HUSKY, TURTLEBOT, "OptiTrack/poses"] {
            let answer = can(&mut fleet, &ask(&who.id(), "acquire", service));
            let outcome = fleet.simulate(&who, "acquire", &bytes(&[service]));
            let code = outcome.map_or_else(|refused| refused.code, |_| Code::Ok);
            assert_eq!(answer.code, code.to_string(), "{} {service}", who.id());
        }
    }
}

#[test]
fn the_owners_admins_may_always_stop_and_take_without_a_policy() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "p", "forbid (principal, action, resource);"]);
    for (action, of) in [("stop", "Husky"), ("resume", "Husky"), ("override", HUSKY), ("confirm", HUSKY)] {
        let yes = can(&mut fleet, &ask("Org2/admin", action, of));
        assert!(yes.allowed && yes.policies.is_empty(), "{action}");
        assert!(!can(&mut fleet, &ask("Org1/Salma", action, of)).allowed, "{action}");
    }
}

#[test]
fn bad_questions_are_refused_with_what_is_wanted() {
    let mut fleet = Fleet::of_the_paper();
    for (code, ask) in [
        (Code::BadArgument, ask("Org1/Farhad", "acquier", HUSKY)),
        (Code::UnknownRobot, ask("Org1/Farhad", "stop", "Huski")),
        (Code::UnknownService, ask("Org1/Farhad", "acquire", "Husky/none")),
        (Code::NotFound, ask("Org1/Nobody", "acquire", HUSKY)),
        (Code::PolicyInvalid, with(ask("Org1/Farhad", "acquire", HUSKY), "permit")),
        (
            Code::BadArgument,
            Ask {
                policies: Some(vec![PolicyText { id: String::new(), text: String::new() }]),
                ..ask("Org1/Farhad", "acquire", HUSKY)
            },
        ),
    ] {
        fleet.refused(&salma(), code, "can", &[&serde_json::to_string(&ask).unwrap()]);
    }
}

#[test]
fn who_of_an_organisation_could_do_it_is_told_in_pages() {
    let mut fleet = Fleet::of_the_paper();
    let ask = serde_json::to_string(&Ask { who: None, ..ask("", "acquire", HUSKY) }).unwrap();
    let page: Page<Could> = fleet.get(&admin1(), "could", &[&ask, "{}"]);
    let told: Vec<_> = page.items.iter().map(|could| (could.who.as_str(), could.allowed)).collect();
    assert_eq!(told, [("Org1/Farhad", false), ("Org1/Salma", true), ("Org1/admin", false)]);
    fleet.refused(&admin1(), Code::BadArgument, "could", &[&ask, "x"]);
}

#[test]
fn the_grants_that_a_set_would_end_are_told_and_putting_it_ends_exactly_those() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.ok(&owner(), "policy", &["put", "old", DEFAULT_POLICY]);
    let text = r#"permit (principal, action, resource) when { principal.name == "Salma" };"#;
    let set = serde_json::to_string(&[PolicyText { id: "new".to_owned(), text: text.to_owned() }]).unwrap();
    let diff: PolicyDiff = fleet.get(&owner(), "diff", &[&set]);
    assert_eq!((diff.grants, diff.ended, diff.ends.len()), (2, 1, 1));
    assert_eq!((diff.added, diff.changed, diff.removed), (vec!["new".to_owned()], vec![], vec!["old".to_owned()]));
    assert_eq!((diff.ends[0].service.as_str(), diff.ends[0].holder.as_str()), (TURTLEBOT, "Org1/Farhad"));
    assert_eq!(diff.ends[0].found, r#"principal.name is "Farhad""#);
    let others: PolicyDiff = fleet.get(&admin1(), "diff", &[&set]);
    assert_eq!(others.grants, 0, "Org1 has no robots");
    fleet.ok(&owner(), "policy", &["put", "new", text]);
    let change: PolicyChange = fleet.get(&owner(), "policy", &["remove", "old"]);
    assert_eq!(change.ended.iter().map(|ended| ended.holder.as_str()).collect::<Vec<_>>(), ["Org1/Farhad"]);
    fleet.refused(&owner(), Code::BadArgument, "diff", &["{}"]);
}

#[test]
fn no_policy_takes_from_the_owners_admins_the_right_to_change_policies() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "policy", &["put", "nothing", "forbid (principal, action, resource);"]);
    let erring = r#"forbid (principal, action, resource) when { principal.name.contains("x") };"#;
    fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "erring", erring]);
    fleet.ok(&owner(), "policy", &["put", "more", r#"forbid (principal in Organisation::"Org2", action, resource);"#]);
    fleet.ok(&owner(), "policy", &["remove", "nothing"]);
    fleet.ok(&owner(), "policy", &["remove", "more"]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
}

#[test]
fn the_faults_of_a_policy_are_told_with_line_and_column() {
    let mut fleet = Fleet::of_the_paper();
    let mut faults = |text: &str| fleet.get::<PolicyCheck>(&salma(), "check", &[text]).faults;
    let places = |faults: &[PolicyFault]| faults.iter().map(|f| (f.line, f.column, f.length)).collect::<Vec<_>>();
    assert!(faults("permit (principal, action, resource);").is_empty());
    let syntax = faults("permit (principal, action, resource)\nwhen { principal.name = 1 };");
    assert_eq!((syntax[0].line, syntax[0].text.as_str()), (2, "when { principal.name = 1 };"), "{syntax:?}");
    let unknown = faults("// ä\npermit (principal, action, resource)\nwhen { principal.nam == \"x\" };");
    assert_eq!(places(&unknown), [(3, 8, 13)], "{unknown:?}");
    let types = faults("permit (principal, action, resource) when { \"ä\" == principal.name && 1 == principal.name };");
    assert_eq!(places(&types), [(1, 70, 19)], "{types:?}");
    let annotation = faults("@description(\"x\")\n@max_rte(\"5\")\npermit (principal, action, resource);");
    assert_eq!(places(&annotation), [(2, 1, 8)], "{annotation:?}");
    let deep = faults(&"(".repeat(100));
    assert_eq!((deep.len(), deep[0].line), (1, 0));
    assert_eq!(faults("").len(), 1);
    assert_eq!(places(&faults("permit (principal == ?principal, action, resource);")), [(1, 22, 10)]);
}

#[test]
fn hostile_policies_are_explained_within_bounds() {
    let mut fleet = Fleet::of_the_paper();
    let deep = format!(
        "permit (principal, action, resource) when {{ {}principal.name == \"x\"{} }};",
        "(".repeat(30),
        ")".repeat(30)
    );
    let long = vec!["principal.name == \"x\""; 300].join(" || ");
    let chain = format!("permit (principal, action, resource) when {{ {long} }};");
    let many = r#"permit (principal, action, resource) when { principal.name == "x" };"#.repeat(100);
    for policy in [deep, chain, many] {
        let no = can(&mut fleet, &with(ask("Org1/Farhad", "publish", TURTLEBOT), &policy));
        assert!(!no.allowed);
        assert!(serde_json::to_string(&no).unwrap().len() < 8192);
    }
}
