//! Changing a robot: adding never does it, and what the new settings allow goes on.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, admin1, bytes, farhad, identity, owner, robot, salma};
use ledger_abac::{DEFAULT_POLICY, Grant, Mode, Reason, RobotAsset, RobotChange, RobotEvent, SettingChange};
use ledger_base::rejection::Code;
use ledger_identity::Role;

const TWO: &str = r#"{"name":"Spot","attribute_required":"Husky","trusted":["Org1","Org2"],"services":[
    {"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist"},{"topic":"/arm","type":"std_msgs/msg/Float64"}]}"#;

fn change(topic: &str, setting: &str, before: &str, after: &str) -> SettingChange {
    SettingChange { topic: topic.into(), setting: setting.into(), before: before.into(), after: after.into() }
}

#[test]
fn a_robot_that_exists_is_not_added_again_and_nobody_loses_it() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    for mode in ["open", "exclusive"] {
        let refusal = fleet.refused(&owner(), Code::AlreadyExists, "setup", &[&robot("Husky", mode)]);
        assert_eq!(refusal.found, "robot of Org2 with Husky/cmd_vel (exclusive, held by Org1/Salma)");
        assert!(refusal.advice().contains("robot set Husky") && refusal.advice().contains("--replace"), "{refusal}");
    }
    let (new, twice) = (robot("Spot", "open"), robot("Spot", "exclusive"));
    fleet.refused(&owner(), Code::AlreadyExists, "setup", &[&new, &twice]);
    fleet.refused(&owner(), Code::UnknownRobot, "robot", &["Spot"]);
    fleet.set(&salma(), HUSKY, 1, 1, 1).unwrap();
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Husky"]);
    assert_eq!((asset.operator.as_str(), asset.services[0].mode.clone()), ("Org1/Salma", Mode::EXCLUSIVE));
}

#[test]
fn a_setting_is_changed_and_everything_else_stays() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let before: RobotAsset = fleet.get(&salma(), "robot", &["Husky"]);
    let done: RobotChange = fleet.get(&owner(), "configure", &["Husky", r#"{"max_age_ms":300}"#]);
    assert_eq!((done.changed, done.ended), (vec![change("/cmd_vel", "max_age_ms", "1000", "300")], vec![]));
    let mut expected = before;
    expected.services[0].max_age_ms = 300;
    assert_ne!(done.robot.version, expected.version);
    expected.version.clone_from(&done.robot.version);
    assert_eq!(done.robot, expected);
    assert_eq!(fleet.newest::<RobotEvent>("robot").change, "updated");
    fleet.set(&salma(), HUSKY, 1, 1, 1).unwrap();
}

#[test]
fn every_setting_can_be_changed() {
    let mut fleet = Fleet::of_the_paper();
    let all = r#"{"attribute_required":"level=3","trusted":["Org1"],"type":"geometry_msgs/msg/TwistStamped","mode":"open",
        "direction":"feed","max_age_ms":300,"lease_ms":20000,"lease_ms_max":30000,"stop_hex":"00010000"}"#;
    let done: RobotChange = fleet.get(&owner(), "configure", &[HUSKY, all]);
    let changed: Vec<_> = done.changed.iter().map(|change| change.setting.as_str()).collect();
    let wanted =
        ["attribute_required", "trusted", "type", "mode", "direction", "max_age_ms", "lease_ms", "lease_ms_max"];
    assert_eq!(changed, [&wanted[..], &["stop_hex"]].concat());
    let none: RobotChange = fleet.get(&owner(), "configure", &[HUSKY, r#"{"stop_hex":""}"#]);
    assert_eq!(none.changed, [change("/cmd_vel", "stop_hex", "00010000", "")]);
    assert_eq!(none.robot.services[0].stop_hex, None);
}

#[test]
fn what_ends_by_a_change_is_told_with_its_reason() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"open"}"#]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let done: RobotChange = fleet.get(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"exclusive"}"#]);
    let ended: Vec<_> = done.ended.iter().map(|grant| (grant.holder.as_str(), grant.reason.word())).collect();
    assert_eq!(ended, [("Org1/Salma", "taken")]);
    let done: RobotChange = fleet.get(&owner(), "configure", &["Turtlebot4", r#"{"attribute_required":"licence"}"#]);
    let ended: Vec<_> = done.ended.iter().map(|grant| (grant.holder.as_str(), grant.reason.word())).collect();
    assert_eq!(ended, [("Org1/Farhad", "policy")]);
}

#[test]
fn a_shorter_lease_counts_for_those_who_hold_the_service_as_well() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY, "600000"]);
    fleet.ok(&owner(), "configure", &[HUSKY, r#"{"lease_ms":1000,"lease_ms_max":2000}"#]);
    let grants: Vec<Grant> = fleet.get(&salma(), "grants", &[HUSKY]);
    assert_eq!((grants[0].holder.as_str(), grants[0].lease_ms), ("Org1/Salma", 2000));
    let renewed: Grant = fleet.get(&salma(), "renew", &[HUSKY]);
    assert_eq!(renewed.expires, fleet.time + 2_000_000);
}

#[test]
fn a_change_to_the_same_is_no_change() {
    let mut fleet = Fleet::of_the_paper();
    let told = fleet.events.len();
    let done: RobotChange = fleet.get(&owner(), "configure", &[HUSKY, r#"{"mode":"exclusive","max_age_ms":1000}"#]);
    assert!(done.changed.is_empty() && done.ended.is_empty());
    let done: Vec<RobotChange> = fleet.get(&owner(), "replace", &[&robot("Husky", "exclusive")]);
    assert!(done[0].changed.is_empty());
    assert_eq!(fleet.events.len(), told, "bridges are not told of what did not happen");
}

#[test]
fn a_change_to_the_same_ends_what_a_policy_permits_no_more_by_now() {
    let mut fleet = Fleet::of_the_paper();
    let noon = fleet.time / 1000 + 500;
    let text = format!("{DEFAULT_POLICY} forbid (principal, action, resource) when {{ context.time >= {noon} }};");
    fleet.ok(&owner(), "policy", &["put", "hours", &text]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.time += 600_000;
    let done: RobotChange = fleet.get(&owner(), "configure", &[HUSKY, r#"{"mode":"exclusive"}"#]);
    assert!(done.changed.is_empty());
    assert_eq!(done.ended[0].reason, Reason::Policy);
}

#[test]
fn the_service_is_named_where_there_are_several() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "setup", &[TWO]);
    let refusal = fleet.refused(&owner(), Code::UnknownService, "configure", &["Spot", r#"{"mode":"open"}"#]);
    assert_eq!(refusal.wanted, "one of Spot/cmd_vel, Spot/arm");
    fleet.refused(&owner(), Code::UnknownService, "configure", &["Spot/leg", r#"{"trusted":["Org1"]}"#]);
    fleet.ok(&owner(), "configure", &["Spot/arm", r#"{"mode":"open"}"#]);
    fleet.ok(&owner(), "configure", &["Spot", r#"{"trusted":["Org1"]}"#]);
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Spot"]);
    let modes: Vec<_> = asset.services.iter().map(|service| service.mode.clone()).collect();
    assert_eq!((modes, asset.trusted), (vec![Mode::EXCLUSIVE, Mode::OPEN], vec!["Org1".to_owned()]));
}

#[test]
fn a_whole_description_replaces_the_one_before_and_is_one_for_a_new_robot() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let arm = robot("Husky", "exclusive").replace("/cmd_vel", "/arm");
    let done: Vec<RobotChange> = fleet.get(&owner(), "replace", &[&arm, TWO]);
    let twist = "geometry_msgs/msg/Twist";
    assert_eq!(done[0].changed, [change("/cmd_vel", "service", twist, ""), change("/arm", "service", "", twist)]);
    assert_eq!(done[0].ended[0].reason, Reason::RobotRemoved);
    assert_eq!((done[1].robot.name.as_str(), done[1].changed.len()), ("Spot", 0));
    let events: Vec<_> = fleet.told(0);
    assert!(events.contains(&("robot", "Spot")), "{events:?}");
}

#[test]
fn only_admins_of_the_owner_change_a_robot() {
    let mut fleet = Fleet::of_the_paper();
    let member = identity("Org2", "Maria", Role::Member, &[], 30);
    for (function, args) in
        [("configure", [HUSKY, r#"{"mode":"open"}"#].to_vec()), ("replace", vec![&*robot("Husky", "open")])]
    {
        fleet.refused(&member, Code::NotAdmin, function, &args);
        fleet.refused(&admin1(), Code::NotOwner, function, &args);
    }
    fleet.refused(&admin1(), Code::NotOwner, "setup", &[&robot("Husky", "open")]);
}

#[test]
fn settings_that_are_none_are_refused() {
    let mut fleet = Fleet::of_the_paper();
    for settings in ["", "{", "{}", "[]", r#"{"colour":"red"}"#, r#"{"mode":7}"#, r#"{"lease_ms":-1}"#] {
        let refusal = fleet.refused(&owner(), Code::BadArgument, "configure", &[HUSKY, settings]);
        assert!(refusal.message.contains("SETTINGS_JSON"), "{settings}: {refusal}");
    }
    for (settings, code) in [
        (r#"{"lease_ms":99}"#, Code::BadArgument),
        (r#"{"lease_ms":700000}"#, Code::BadArgument),
        (r#"{"stop_hex":"00"}"#, Code::BadArgument),
        (r#"{"attribute_required":"=x"}"#, Code::BadArgument),
        (r#"{"trusted":["Org9"]}"#, Code::BadArgument),
        (r#"{"type":"Twist"}"#, Code::BadName),
    ] {
        fleet.refused(&owner(), code, "configure", &[HUSKY, settings]);
    }
    fleet.refused(&owner(), Code::UnknownRobot, "configure", &["Spot", r#"{"mode":"open"}"#]);
    assert_eq!(fleet.simulate(&salma(), "robots", &bytes(&[])).unwrap(), {
        let fresh = Fleet::of_the_paper();
        fresh.simulate(&salma(), "robots", &bytes(&[])).unwrap()
    });
}

#[test]
fn a_maximum_of_the_robots_own_is_for_services_whose_messages_ask_for_a_speed() {
    let mut fleet = Fleet::of_the_paper();
    let slow = r#"{"sharing":{"max_linear_mm_s":300,"max_angular_mrad_s":1000}}"#;
    let done: RobotChange = fleet.get(&owner(), "configure", &["Husky", slow]);
    assert_eq!(done.changed.len(), 2);
    assert_eq!(done.robot.services[0].sharing.max_linear_mm_s, Some(300));
    fleet.refused(&owner(), Code::BadArgument, "configure", &["OptiTrack", slow]);
    fleet.refused(&owner(), Code::BadArgument, "configure", &["Husky", r#"{"sharing":{"max_linear_mm_s":10000001}}"#]);
    // Angles of wheels are no angular speed.
    let car = r#"{"type":"ackermann_msgs/msg/AckermannDrive"}"#;
    fleet.refused(&owner(), Code::BadArgument, "configure", &["Husky", car]);
    fleet.ok(
        &owner(),
        "configure",
        &["Husky", r#"{"type":"ackermann_msgs/msg/AckermannDrive","clear":["max_angular_mrad_s"]}"#],
    );
}
