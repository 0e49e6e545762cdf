//! A network that ran under rules 2 goes on under rules 3, with the robots, grants and policies that it has.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, admin1, farhad, owner, robot, salma};
use ledger::msp::QUOTAS;
use ledger::{PAGE_MAX, Rules};
use ledger_abac::{Grant, PolicyEntry};
use ledger_base::rejection::Code;
use ledger_storage::state::StateRead;
use std::collections::BTreeSet;

const ANYBODY: &str = "permit (principal, action, resource);";
const SPOT: &str = "Spot/cmd_vel";

fn rules(number: u32) -> Rules {
    Rules::find(number).unwrap()
}

/// The keys of the index of owners: `ORGANISATION/ROBOT`, and an empty one when it is complete.
fn index(fleet: &Fleet) -> BTreeSet<String> {
    let prefix = b"abac\0owned/";
    let keys = fleet.state.range(prefix, None, usize::MAX).unwrap();
    keys.iter().map(|(key, _)| String::from_utf8(key[prefix.len()..].to_vec()).unwrap()).collect()
}

/// Under rules 2: the robots of the paper, and one of Org1 with a policy that rules 3 would refuse. Each is held.
fn before() -> (Fleet, [Grant; 3]) {
    let mut fleet = Fleet::of_the_paper_under(rules(2));
    fleet.ok(&admin1(), "setup", &[&robot("Spot", "exclusive")]);
    let wide = format!(
        "permit (principal, action, resource) when {{ principal.name like \"F*{}*\" || true }};",
        "a".repeat(300)
    );
    fleet.ok(&admin1(), "policy", &["put", "wide", &wide]);
    let held = [(farhad(), TURTLEBOT), (salma(), HUSKY), (farhad(), SPOT)];
    let grants = held.map(|(who, service)| fleet.get(&who, "acquire", &[service, "60000"]));
    (fleet, grants)
}

#[test]
fn grants_of_rules_2_are_used_renewed_and_ended_under_rules_3() {
    let (mut fleet, [turtlebot, husky, _]) = before();
    fleet.set(&farhad(), TURTLEBOT, turtlebot.epoch, 1, 1).unwrap();
    fleet.rules = rules(3);
    assert_eq!(fleet.get::<Vec<Grant>>(&salma(), "grants", &[]).len(), 3);
    fleet.set(&farhad(), TURTLEBOT, turtlebot.epoch, 2, 1).unwrap();
    fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, turtlebot.epoch, 3);
    let renewed: Grant = fleet.get(&salma(), "renew", &[HUSKY, "60000"]);
    assert!(renewed.epoch == husky.epoch && renewed.expires > husky.expires, "{renewed:?}");
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    let next: Grant = fleet.get(&farhad(), "acquire", &[TURTLEBOT]);
    assert!(next.epoch > turtlebot.epoch, "an epoch never comes again");
    fleet.time = renewed.expires;
    fleet.tick();
    assert_eq!(fleet.get::<Vec<Grant>>(&salma(), "grants", &[HUSKY]), [], "leases of rules 2 and 3 end");
}

#[test]
fn the_first_change_of_a_robot_under_rules_3_finds_the_owners_of_all_robots_of_rules_2() {
    let (mut fleet, _) = before();
    assert_eq!(index(&fleet), BTreeSet::new());
    fleet.rules = rules(3);
    fleet.ok(&owner(), "setup", &[&robot("R", "open")]);
    let all = ["", "Org1/Spot", "Org2/Husky", "Org2/OptiTrack", "Org2/R", "Org2/Turtlebot4"];
    assert_eq!(index(&fleet), all.map(str::to_owned).into());
    fleet.ok(&owner(), "remove", &["Husky"]);
    assert!(!index(&fleet).contains("Org2/Husky"));
    assert_eq!(fleet.get::<Vec<Grant>>(&salma(), "grants", &[]).len(), 2, "its grant ended with it");
    fleet.remove_organisation("Org1");
    assert!(!index(&fleet).contains("Org1/Spot"), "{:?}", index(&fleet));
}

#[test]
fn an_organisation_with_more_robots_than_its_quota_keeps_them_and_adds_none() {
    let (mut fleet, _) = before();
    let name = |number: u64| format!("R{number}");
    for number in 0..QUOTAS.robots {
        fleet.ok(&owner(), "setup", &[&robot(&name(number), "open")]);
    }
    fleet.rules = rules(3);
    let refused = fleet.refused(&owner(), Code::QuotaReached, "setup", &[&robot("More", "open")]);
    assert!(refused.message.contains("Org2"), "{refused}");
    fleet.ok(&owner(), "replace", &[&robot("R0", "exclusive")]);
    fleet.ok(&admin1(), "setup", &[&robot("Own", "open")]);
    // Three of the paper and one more than the quota then.
    for number in 0..4 {
        fleet.ok(&owner(), "remove", &[&name(number)]);
    }
    fleet.ok(&owner(), "setup", &[&robot("More", "open")]);
    fleet.refused(&owner(), Code::QuotaReached, "setup", &[&robot("Most", "open")]);
    let listed: Vec<serde_json::Value> = fleet.get(&salma(), "robots", &[]);
    assert_eq!(listed.len() as u64, QUOTAS.robots + 2);
    assert!(listed.len() <= PAGE_MAX);
}

#[test]
fn policies_that_rules_3_would_refuse_deny_until_their_owner_puts_smaller_ones_and_others_work_on() {
    let (mut fleet, [turtlebot, _, spot]) = before();
    fleet.ok(&owner(), "policy", &["put", "all", ANYBODY]);
    fleet.set(&farhad(), SPOT, spot.epoch, 1, 1).unwrap();
    fleet.rules = rules(3);
    // Also for a node that has just started.
    fleet.forget();
    fleet.set(&farhad(), SPOT, spot.epoch, 2, 1).unwrap();
    let refused = fleet.refused(&farhad(), Code::PolicyError, "renew", &[SPOT]);
    assert!(refused.to_string().contains("Org1"), "{refused}");
    fleet.ok(&farhad(), "release", &[SPOT]);
    fleet.refused(&farhad(), Code::PolicyError, "acquire", &[SPOT]);
    fleet.set(&farhad(), TURTLEBOT, turtlebot.epoch, 1, 1).unwrap();
    assert_eq!(fleet.get::<Vec<PolicyEntry>>(&salma(), "policies", &[]).len(), 3, "they are still shown");
    let wide = format!("permit (principal, action, resource) when {{ principal.name like \"{}\" }};", "a".repeat(300));
    fleet.refused(&admin1(), Code::PolicyInvalid, "policy", &["put", "another", &wide]);
    fleet.ok(&admin1(), "policy", &["put", "wide", ANYBODY]);
    let spot: Grant = fleet.get(&farhad(), "acquire", &[SPOT]);
    fleet.set(&farhad(), SPOT, spot.epoch, 1, 1).unwrap();
}

#[test]
fn types_of_ros_2_services_and_actions_are_registered_since_rules_3() {
    let lamp = robot("Lamp", "exclusive").replace("geometry_msgs/msg/Twist", "std_srvs/srv/SetBool");
    let nav = robot("Nav", "exclusive").replace("geometry_msgs/msg/Twist", "nav2_msgs/action/NavigateToPose");
    let (mut fleet, _) = before();
    fleet.refused(&owner(), Code::BadName, "setup", &[&lamp]);
    fleet.refused(&owner(), Code::BadName, "setup", &[&nav]);
    fleet.rules = rules(3);
    fleet.ok(&owner(), "setup", &[&lamp]);
    fleet.ok(&owner(), "setup", &[&nav]);
    for bad in ["std_srvs/srv/", "std_srvs/service/SetBool", "std_srvs/srv/Set Bool", "srv/SetBool"] {
        let bad = robot("Lamp2", "exclusive").replace("geometry_msgs/msg/Twist", bad);
        fleet.refused(&owner(), Code::BadName, "setup", &[&bad]);
    }
}
