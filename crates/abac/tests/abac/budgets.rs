//! Budgets: which functions only read, the counts of a call, quotas and pages.

use crate::arguments::FUNCTIONS;
use crate::fleet::{Fleet, HUSKY, TURTLEBOT, TWIST, admin1, bytes, farhad, identity, owner, robot, salma};
use bytes::Bytes;
use ledger::msp::QUOTAS;
use ledger::{CALL_BUDGET, Chaincode, PAGE_MAX, Page, Usage};
use ledger_abac::{DEFAULT_POLICY, Grant, PolicyChange, PolicyEntry, RobotAsset};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

/// A call of every function that succeeds in the network of the paper.
fn calls() -> Vec<(&'static str, Identity, Vec<Bytes>)> {
    let spot = robot("Spot", "open");
    let text = |args: &[&str]| bytes(args);
    let mut set = text(&[HUSKY, "1", "1"]);
    set.push(Bytes::from_static(&TWIST));
    vec![
        ("GetSubmittingClientIdentity", salma(), vec![]),
        ("authorize", salma(), text(&[TURTLEBOT])),
        ("grants", salma(), vec![]),
        ("grants", salma(), text(&["{}"])),
        ("latest", salma(), text(&[HUSKY])),
        ("policies", salma(), vec![]),
        ("policies", salma(), text(&["{}"])),
        ("robot", salma(), text(&["Husky"])),
        ("robots", salma(), vec![]),
        ("robots", salma(), text(&["{}"])),
        ("service", salma(), text(&[HUSKY])),
        ("setup", owner(), text(&[&spot])),
        ("acquire", salma(), text(&[HUSKY])),
        ("renew", salma(), text(&[HUSKY])),
        ("set", salma(), set),
        ("configure", owner(), text(&["Spot/cmd_vel", r#"{"mode":"exclusive"}"#])),
        ("replace", owner(), text(&[&spot])),
        ("policy", owner(), text(&["put", "p", DEFAULT_POLICY])),
        ("declare", salma(), text(&["Husky"])),
        ("release", salma(), text(&[HUSKY])),
        ("remove", owner(), text(&["Spot"])),
    ]
}

#[test]
fn functions_that_are_said_to_read_change_nothing_and_all_others_may() {
    let mut fleet = Fleet::of_the_paper();
    let reads = fleet.abac.reads();
    let calls = calls();
    for function in FUNCTIONS {
        assert!(calls.iter().any(|(called, ..)| *called == function), "{function} is not called");
    }
    for (function, who, args) in calls {
        let since = fleet.events.len();
        fleet.call(&who, function, &args).unwrap();
        let changed = !fleet.writes.last().unwrap().is_empty() || fleet.events.len() > since;
        assert_eq!(changed, !reads.contains(&function), "{function}");
    }
}

#[test]
fn what_a_call_uses_does_not_depend_on_what_a_node_remembers() {
    let used = |forgets: bool| -> Vec<Usage> {
        let mut fleet = Fleet::of_the_paper();
        let mut used = Vec::new();
        for (function, who, args) in calls() {
            if forgets {
                fleet.forget();
            } else {
                fleet.simulate(&who, function, &args).unwrap();
            }
            fleet.call(&who, function, &args).unwrap();
            used.push(fleet.meter.used());
        }
        used
    };
    let (cold, warm) = (used(true), used(false));
    assert_eq!(cold, warm);
    assert!(cold.iter().any(|used| used.steps > 0) && cold.iter().all(|used| used.answer_bytes > 0));
}

/// Policies as long as they may be, each with as many patterns as the steps of all allow.
fn costly(number: usize) -> String {
    let pattern = format!("principal.name like \"{}b\"", "*a".repeat(30));
    format!("permit (principal, action, resource) when {{ {pattern} || {number} == 100 }};")
}

#[test]
fn a_decision_costs_steps_of_the_owners_policies_only() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    let plain = fleet.meter.used().steps;
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    assert_eq!(plain, 2 * DEFAULT_POLICY.len() as u64, "acquire and publish");
    for number in 0..64 {
        fleet.ok(&admin1(), "policy", &["put", &format!("p{number}"), &costly(number)]);
    }
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    assert_eq!(fleet.meter.used().steps, plain, "the policies of another owner are not evaluated");
    fleet.ok(&admin1(), "setup", &[&robot("Spot", "open")]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &["Spot/cmd_vel"]);
    let costly = fleet.meter.used().steps;
    assert!(costly > plain && costly <= 2 * 1024 * 1024 && costly < CALL_BUDGET.steps, "{costly}");
}

#[test]
fn policies_that_take_much_work_are_refused_when_they_are_put() {
    let mut fleet = Fleet::of_the_paper();
    let like =
        |pattern: &str| format!("permit (principal, action, resource) when {{ principal.name like \"{pattern}\" }};");
    let set = |elements: usize| {
        let list = vec!["\"a\""; elements].join(",");
        format!("permit (principal, action, resource) when {{ [{list}].contains(principal.name) }};")
    };
    let quoted = format!("permit (principal, action, resource) when {{ principal.name == \"{}\" }};", "a".repeat(5000));
    for (text, found) in [
        (like(&"*a".repeat(65)), "65 wildcards"),
        (like(&format!("*{}", "a".repeat(256))), "bytes in a pattern"),
        (set(257), "257 elements"),
        (quoted, "bytes in a text"),
    ] {
        let refused = fleet.refused(&owner(), Code::PolicyInvalid, "policy", &["put", "p", &text]);
        assert!(refused.found.contains(found), "{refused}");
    }
    // Each is small enough, all together are not.
    let many = |number: usize| {
        let like = format!("principal.name like \"*{}\" || ", "a".repeat(240)).repeat(20);
        format!("permit (principal, action, resource) when {{ {like} {number} == 0 }};")
    };
    let put = |fleet: &mut Fleet, number: usize| {
        fleet.call(&owner(), "policy", &bytes(&["put", &format!("p{number}"), &many(number)]))
    };
    let refused = (0..64).find_map(|number| put(&mut fleet, number).err()).unwrap();
    assert!(refused.code == Code::PolicyInvalid && refused.found.ends_with("steps"), "{refused}");
    fleet.ok(&owner(), "policy", &["put", "p0", "permit (principal, action, resource);"]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
}

#[test]
fn lists_come_in_pages_that_leave_nothing_out() {
    let mut fleet = Fleet::empty();
    for number in 0..10 {
        fleet.ok(&owner(), "setup", &[&robot(&format!("R{number}"), "open")]);
        fleet.ok(&owner(), "policy", &["put", &format!("p{number}"), "permit (principal, action, resource);"]);
        fleet.ok(&farhad(), "acquire", &[&format!("R{number}/cmd_vel")]);
    }
    fn all<T: serde::de::DeserializeOwned + serde::Serialize>(fleet: &mut Fleet, function: &str) -> Vec<T> {
        let (mut items, mut after) = (Vec::new(), String::new());
        loop {
            let page: Page<T> = fleet.get(&salma(), function, &[&format!(r#"{{"most":3{after}}}"#)]);
            assert!(page.items.len() <= 4, "three, and the built-in policy");
            items.extend(page.items);
            let Some(next) = page.next else { return items };
            after = format!(r#","after":"{next}""#);
        }
    }
    let robots: Vec<RobotAsset> = all(&mut fleet, "robots");
    assert_eq!(robots, fleet.get::<Vec<RobotAsset>>(&salma(), "robots", &[]));
    let grants: Vec<Grant> = all(&mut fleet, "grants");
    assert_eq!(grants, fleet.get::<Vec<Grant>>(&salma(), "grants", &[]));
    let policies: Vec<PolicyEntry> = all(&mut fleet, "policies");
    assert_eq!(policies, fleet.get::<Vec<PolicyEntry>>(&salma(), "policies", &[]));
    for wrong in [r#"{"most":"x"}"#, r#"{"after":"zz"}"#, r#"{"before":"00"}"#] {
        fleet.refused(&salma(), Code::BadArgument, "robots", &[wrong]);
    }
}

#[test]
fn a_list_that_is_asked_for_without_pages_is_one_page_or_refused() {
    let add = |fleet: &mut Fleet, number: usize| {
        let admin = identity(&format!("Org{}", number / 100 + 1), "admin", Role::Admin, &[], 4);
        if number.is_multiple_of(100) {
            fleet.ok(&admin, "policy", &["put", "all", "permit (principal, action, resource);"]);
        }
        fleet.ok(&admin, "setup", &[&robot(&format!("R{number}"), "open")]);
        fleet.ok(&farhad(), "acquire", &[&format!("R{number}/cmd_vel")]);
    };
    let mut fleet = Fleet::of_the_paper();
    (0..PAGE_MAX - 3).for_each(|number| add(&mut fleet, number));
    let listed: Vec<serde_json::Value> = fleet.get(&salma(), "robots", &[]);
    assert_eq!(listed.len(), PAGE_MAX, "with the three of the paper");
    add(&mut fleet, PAGE_MAX - 3);
    let refused = fleet.refused(&salma(), Code::OverBudget, "robots", &[]);
    assert!(refused.advice().contains("{}"), "{refused}");
    (PAGE_MAX - 2..=PAGE_MAX).for_each(|number| add(&mut fleet, number));
    fleet.refused(&salma(), Code::OverBudget, "grants", &[]);
    // A page ends by its bytes, too.
    for number in 0..40 {
        let text = format!("permit (principal, action, resource); // {}", "x".repeat(8000));
        fleet.ok(&owner(), "policy", &["put", &format!("p{number}"), &text]);
    }
    fleet.refused(&salma(), Code::OverBudget, "policies", &[]);
}

#[test]
fn an_organisation_that_fills_its_quota_of_robots_keeps_no_other_from_adding_one() {
    let mut fleet = Fleet::empty();
    let add = |fleet: &mut Fleet, by: &Identity, name: &str| fleet.call(by, "setup", &bytes(&[&robot(name, "open")]));
    for number in 0..QUOTAS.robots {
        add(&mut fleet, &owner(), &format!("R{number}")).unwrap();
    }
    let refused = add(&mut fleet, &owner(), "One").unwrap_err();
    assert_eq!(refused.code, Code::QuotaReached);
    assert!(refused.found.contains("128 robots") && refused.advice().contains("robot remove"), "{refused}");
    add(&mut fleet, &admin1(), "Spot").unwrap();
    fleet.ok(&owner(), "replace", &[&robot("R0", "exclusive")]);
    fleet.ok(&owner(), "remove", &["R0"]);
    add(&mut fleet, &owner(), "One").unwrap();
}

#[test]
fn an_owner_lowers_the_budget_of_a_service_alone_and_raises_it_up_to_the_quota_only() {
    let mut fleet = Fleet::empty();
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "open")]);
    let budget =
        |bytes: u64, messages: u64| format!(r#"{{"sharing":{{"bytes_per_s":{bytes},"messages_per_s":{messages}}}}}"#);
    fleet.ok(&owner(), "configure", &["Turtlebot4", &budget(1_000, 10)]);
    fleet.ok(
        &owner(),
        "configure",
        &["Turtlebot4", &budget(QUOTAS.service_bytes_per_s, QUOTAS.service_messages_per_s)],
    );
    for more in [budget(QUOTAS.service_bytes_per_s + 1, 10), budget(1_000, QUOTAS.service_messages_per_s + 1)] {
        let refused = fleet.refused(&owner(), Code::QuotaReached, "configure", &["Turtlebot4", &more]);
        assert!(refused.message.contains("Turtlebot4/cmd_vel") && refused.advice().contains("set_quota"), "{refused}");
    }
    fleet.refused(&owner(), Code::BadArgument, "configure", &["Turtlebot4", &budget(0, 10)]);
    fleet.refused(&admin1(), Code::NotOwner, "configure", &["Turtlebot4", &budget(1_000, 10)]);
}

#[test]
fn who_mistypes_the_name_of_a_robot_has_few_robots_read() {
    let mut fleet = Fleet::empty();
    for number in 0..QUOTAS.robots {
        fleet.ok(&owner(), "setup", &[&robot(&format!("R{number}"), "open")]);
    }
    fleet.refused(&salma(), Code::UnknownRobot, "acquire", &["R1O"]);
    assert!(fleet.meter.used().reads < 80, "{:?}", fleet.meter.used());
}

#[test]
fn a_change_of_policies_decides_about_very_many_grants_over_several_blocks_and_none_is_used_meanwhile() {
    let mut fleet = Fleet::empty();
    // So costly that a call decides about eight grants and a block about one.
    let heavy = |last: &str| {
        let like = format!("principal.name like \"*{}\" || ", "a".repeat(240)).repeat(20);
        format!("permit (principal, action, resource) when {{ {like} principal.name != \"{last}\" }};")
    };
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "open"), &robot("Husky", "open")]);
    for number in 0..3 {
        fleet.ok(&owner(), "policy", &["put", &format!("p{number}"), &heavy("nobody")]);
    }
    let user = |n: u8| {
        let mut user = salma();
        (user.name, user.serial) = (format!("user{n:02}"), vec![9, n]);
        user.fingerprint[..2].copy_from_slice(&[9, n]);
        user
    };
    for n in 0..20 {
        fleet.ok(&user(n), "acquire", &[TURTLEBOT, "600000"]);
        fleet.ok(&user(n), "acquire", &[HUSKY, "600000"]);
    }
    fleet.ok(&admin1(), "setup", &[&robot("Spot", "open")]);
    fleet.ok(&salma(), "authorize", &["Spot"]);
    let change: PolicyChange = fleet.get(
        &owner(),
        "policy",
        &["put", "no", "forbid (principal, action, resource) when { principal.name != \"user07\" };"],
    );
    assert!((1..40).contains(&change.ended.len()), "{} in the call", change.ended.len());
    let used = fleet.meter.used();
    assert!(used.steps <= CALL_BUDGET.steps / 2, "{used:?}");
    // What was not decided yet is of no use.
    fleet.set_refused(&user(19), Code::DeniedByPolicy, TURTLEBOT, 20, 1);
    assert_eq!(fleet.next_deadline(), Some(0), "the leader orders blocks until all is decided");
    let mut blocks = 0;
    while fleet.next_deadline() == Some(0) {
        fleet.tick();
        blocks += 1;
        assert!(blocks < 100);
    }
    assert!(blocks > 3, "{blocks}");
    let left: Vec<Grant> = fleet.get(&salma(), "grants", &[]);
    assert!(left.len() == 2 && left.iter().all(|grant| grant.holder == "Org1/user07"), "{left:?}");
}
