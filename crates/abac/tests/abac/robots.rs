//! Registering robots: who may, and whom a robot trusts.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, admin1, bytes, farhad, identity, owner, robot, salma};
use ledger_abac::{
    Declaration, Direction, Fencing, Grant, Mode, Publishing, Reason, Released, RobotAsset, RobotEvent, ServiceState,
};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use ledger_storage::state::StateRead;
use std::collections::BTreeSet;

#[test]
fn only_an_admin_registers_robots() {
    let mut fleet = Fleet::empty();
    for role in [Role::Member, Role::Node, Role::Robot] {
        let who = identity("Org2", "Maria", role, &[], 30);
        let refusal = fleet.refused(&who, Code::NotAdmin, "setup", &[&robot("Spot", "open")]);
        assert_eq!((refusal.wanted.as_str(), refusal.advice()), ("an admin of Org2", Code::NotAdmin.advice()));
    }
    fleet.ok(&owner(), "setup", &[&robot("Spot", "open")]);
    let event: RobotEvent = fleet.newest("robot");
    assert_eq!((event.robot.as_str(), event.change.as_str()), ("Spot", "registered"));
    let who = identity("Org2", "Maria", Role::Member, &[], 30);
    fleet.refused(&who, Code::NotAdmin, "remove", &["Spot"]);
}

#[test]
fn a_robot_belongs_to_the_organisation_that_registered_it() {
    let mut fleet = Fleet::of_the_paper();
    let refusal = fleet.refused(&admin1(), Code::NotOwner, "setup", &[&robot("Husky", "open")]);
    assert!(refusal.message.contains("belongs to Org2"), "{refusal}");
    fleet.refused(&admin1(), Code::NotOwner, "remove", &["Husky"]);
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Husky"]);
    assert_eq!((asset.organisation.as_str(), asset.services[0].mode.clone()), ("Org2", Mode::EXCLUSIVE));
}

#[test]
fn one_bad_robot_undoes_the_whole_setup() {
    let mut fleet = Fleet::empty();
    fleet.refused(&owner(), Code::BadArgument, "setup", &[&robot("Spot", "open"), "{}"]);
    assert_eq!(fleet.get::<Vec<RobotAsset>>(&owner(), "robots", &[]), []);
    assert!(fleet.events.is_empty());
}

#[test]
fn an_organisation_that_joins_later_is_not_trusted_until_the_owner_says_so() {
    let mut fleet = Fleet::of_the_paper();
    fleet.members.0.lock().unwrap().push("Org3");
    let mallory = identity("Org3", "Mallory", Role::Member, &["Turtlebot4", "Husky"], 66);
    let refusal = fleet.refused(&mallory, Code::DeniedByPolicy, "acquire", &[HUSKY]);
    assert_eq!((refusal.found.as_str(), refusal.wanted.as_str()), ("organisation Org3", "one of Org1, Org2"));
    assert!(refusal.advice().contains("ledgerctl robot set Husky trust=Org1,Org2,Org3"), "{}", refusal.advice());
    // Updating the robot does not let it in by accident.
    fleet.ok(&owner(), "replace", &[&robot("Husky", "exclusive")]);
    fleet.refused(&mallory, Code::DeniedByPolicy, "acquire", &[HUSKY]);
    let trusting = robot("Husky", "exclusive").replace(r#"["Org1","Org2"]"#, r#"["Org3"]"#);
    fleet.ok(&owner(), "replace", &[&trusting]);
    fleet.ok(&mallory, "acquire", &[HUSKY]);
    fleet.ok(&mallory, "release", &[HUSKY]);
    fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
}

#[test]
fn a_robot_trusts_nobody_but_its_owner_until_the_owner_names_others_and_keeps_its_trust_when_it_is_replaced() {
    let mut fleet = Fleet::empty();
    let plain = robot("Husky", "exclusive").replace(r#""trusted":["Org1","Org2"],"#, "");
    let trusted = |fleet: &mut Fleet| fleet.get::<RobotAsset>(&owner(), "robot", &["Husky"]).trusted;
    fleet.ok(&owner(), "setup", &[&plain]);
    assert_eq!(trusted(&mut fleet), ["Org2"]);
    fleet.refused(&salma(), Code::DeniedByPolicy, "acquire", &[HUSKY]);
    fleet.ok(&owner(), "configure", &["Husky", r#"{"trusted":["Org2","Org1"]}"#]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.ok(&owner(), "replace", &[&plain]);
    assert_eq!(trusted(&mut fleet), ["Org1", "Org2"]);
}

#[test]
fn a_name_that_differs_from_a_robots_only_in_case_is_rejected() {
    let mut fleet = Fleet::of_the_paper();
    for function in ["setup", "replace"] {
        let refused = fleet.refused(&owner(), Code::AlreadyExists, function, &[&robot("turtlebot4", "open")]);
        assert_eq!(refused.found, "robot Turtlebot4");
        assert!(refused.message.contains("upper and lower case"), "{refused}");
    }
    fleet.ok(&owner(), "replace", &[&robot("Turtlebot4", "open")]);
}

#[test]
fn a_trusted_organisation_must_exist() {
    let mut fleet = Fleet::empty();
    let spec = robot("Husky", "open").replace(r#"["Org1","Org2"]"#, r#"["Org1","Org22"]"#);
    let refusal = fleet.refused(&owner(), Code::BadArgument, "setup", &[&spec]);
    assert_eq!(refusal.advice(), r#"did you mean "Org2"?"#);
}

#[test]
fn a_stricter_robot_ends_the_grants_it_no_longer_permits() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.ok(&owner(), "replace", &[&robot("Husky", "exclusive")]);
    fleet.set(&salma(), HUSKY, 1, 1, 1).unwrap();
    let stricter = robot("Husky", "exclusive").replace("\"Husky\",\n", "\"licence\",\n");
    fleet.ok(&owner(), "replace", &[&stricter]);
    assert_eq!(fleet.newest::<Released>("released").reason, Reason::Policy);
    fleet.set_refused(&salma(), Code::MissingAttribute, HUSKY, 1, 2);
}

#[test]
fn a_service_that_is_gone_ends_its_grants() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.ok(&owner(), "replace", &[&robot("Husky", "exclusive").replace("/cmd_vel", "/arm")]);
    assert_eq!(fleet.newest::<Released>("released").reason, Reason::RobotRemoved);
    let refusal = fleet.refused(&salma(), Code::UnknownService, "acquire", &[HUSKY]);
    assert_eq!(refusal.wanted, "one of Husky/arm");
}

#[test]
fn an_unknown_name_is_answered_with_the_nearest_one() {
    let mut fleet = Fleet::of_the_paper();
    let refusal = fleet.refused(&salma(), Code::UnknownRobot, "acquire", &["turtelbot4"]);
    assert_eq!(refusal.advice(), r#"did you mean "Turtlebot4"?"#);
    let refusal = fleet.refused(&salma(), Code::UnknownService, "acquire", &["Turtlebot4/cmdvel"]);
    assert_eq!(refusal.advice(), r#"did you mean "Turtlebot4/cmd_vel"?"#);
    let refusal = fleet.refused(&salma(), Code::UnknownRobot, "robot", &["Atlas"]);
    assert_eq!(refusal.advice(), "ledgerctl robot list");
    let refusal = fleet.refused(&salma(), Code::UnknownFunction, "aquire", &[TURTLEBOT]);
    assert_eq!(refusal.advice(), r#"did you mean "acquire"?"#);
}

#[test]
fn the_name_of_a_robot_stands_for_its_only_service() {
    let mut fleet = Fleet::of_the_paper();
    let two = r#"{"name":"Husky","attribute_required":"Husky","trusted":["Org1","Org2"],"services":[
        {"topic":"/cmd_vel","type":"geometry_msgs/msg/Twist"},{"topic":"/arm/joint","type":"std_msgs/msg/Float64"}]}"#;
    fleet.ok(&owner(), "replace", &[two]);
    let refusal = fleet.refused(&salma(), Code::UnknownService, "acquire", &["Husky"]);
    assert_eq!(refusal.wanted, "one of Husky/cmd_vel, Husky/arm/joint");
    fleet.ok(&salma(), "acquire", &["Husky/arm/joint"]);
    fleet.ok(&salma(), "acquire", &["Turtlebot4"]);
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Husky"]);
    assert_eq!((asset.sub_topic.as_str(), asset.operator.as_str()), ("/cmd_vel,/arm/joint", "Org1/Salma"));
}

#[test]
fn defaults_are_filled_in_and_kept() {
    let mut fleet = Fleet::of_the_paper();
    let robots: Vec<RobotAsset> = fleet.get(&salma(), "robots", &[]);
    let (husky, camera) = (&robots[0].services[0], &robots[1].services[0]);
    assert_eq!(
        (husky.direction.known(), husky.max_age_ms, husky.lease_ms, husky.lease_ms_max),
        (Some(Direction::Command), 1000, 10_000, 600_000)
    );
    assert_eq!((camera.mode.clone(), camera.direction.known()), (Mode::OPEN, Some(Direction::Feed)));
    assert_eq!(robots[0].attribute_required, "Husky=true");
}

#[test]
fn what_is_no_ros_name_or_out_of_range_is_refused() {
    let mut fleet = Fleet::empty();
    let good = robot("Husky", "exclusive");
    let mode = r#""mode":"exclusive""#;
    let cases = [
        (good.replace("\"name\":\"Husky\"", "\"name\":\"a/b\""), Code::BadName),
        (good.replace("\"name\":\"Husky\"", "\"name\":\"\""), Code::BadName),
        (good.replace("\"name\":\"Husky\"", &format!("\"name\":\"{}\"", "x".repeat(65))), Code::BadName),
        (good.replace("/cmd_vel", "cmd_vel"), Code::BadName),
        (good.replace("/cmd_vel", "/cmd//vel"), Code::BadName),
        (good.replace("/cmd_vel", "/1st"), Code::BadName),
        (good.replace("/cmd_vel", "/größe"), Code::BadName),
        (good.replace("/cmd_vel", &format!("/{}", "x".repeat(255))), Code::BadName),
        (good.replace("geometry_msgs/msg/Twist", "geometry_msgs/Twist"), Code::BadName),
        (good.replace("geometry_msgs/msg/Twist", "geometry_msgs/idl/Twist"), Code::BadName),
        (good.replace("\"Husky\",\n", "\"\",\n"), Code::BadArgument),
        (good.replace("\"Husky\",\n", "\"=x\",\n"), Code::BadArgument),
        (good.replace(mode, r#""mode":"limited""#), Code::BadArgument),
        (good.replace(mode, r#""lease_ms":99"#), Code::BadArgument),
        (good.replace(mode, r#""lease_ms":86400001"#), Code::BadArgument),
        (good.replace(mode, r#""lease_ms":20000,"lease_ms_max":10000"#), Code::BadArgument),
        (good.replace(mode, r#""max_age_ms":0"#), Code::BadArgument),
        (good.replace(mode, r#""stop_hex":"000100"#), Code::BadArgument),
        (good.replace(mode, r#""stop_hex":"xyz""#), Code::BadArgument),
        (good.replace(mode, r#""colour":"red""#), Code::BadArgument),
        (good.replace("\"services\":[", "\"services\":[],\"x\":["), Code::BadArgument),
        (
            r#"{"name":"Husky","attribute_required":"x","trusted":["Org1","Org2"],"services":[]}"#.to_owned(),
            Code::BadArgument,
        ),
    ];
    for (spec, code) in cases {
        assert_ne!(spec, good, "the case changes nothing");
        fleet.refused(&owner(), code, "setup", &[&spec]);
    }
    let twice = good.replace("}]}", r#"},{"topic":"/cmd_vel","type":"std_msgs/msg/Empty"}]}"#);
    fleet.refused(&owner(), Code::AlreadyExists, "setup", &[&twice]);
    let near = fleet.refused(&owner(), Code::BadName, "setup", &[&good.replace("geometry_msgs/msg", "geometry_msgs")]);
    assert_eq!(near.advice(), "did you mean geometry_msgs/msg/Twist?");
    let stop = good.replace(mode, r#""stop_hex":"00010000""#);
    fleet.ok(&owner(), "setup", &[&stop]);
}

#[test]
fn capabilities_are_told_to_whoever_asks_and_in_the_answer_of_a_transaction() {
    let mut fleet = Fleet::of_the_paper();
    let asked: ServiceState = fleet.get(&salma(), "service", &["Husky"]);
    let known = asked.capabilities().unwrap();
    assert_eq!((known.publishing, known.fencing), (Publishing::Grant, Fencing::Newest));
    fleet.transaction = Hash([7; 32]);
    for function in ["service", "robot"] {
        fleet.refused(&owner(), Code::QueryOnly, function, &["Husky"]);
    }
    for (function, argument) in [("setup", robot("Spot", "open")), ("replace", robot("Spot", "exclusive"))] {
        let argument = argument.as_str();
        let answer = fleet.call(&owner(), function, &bytes(&[argument])).unwrap();
        let answer = std::str::from_utf8(&answer).unwrap();
        assert!(answer.contains("Org2") && answer.contains("capabilities"), "{function}: {answer}");
    }
}

#[test]
fn a_declaration_tells_how_a_robot_stands_and_writes_its_record_as_it_is() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let declared: Declaration = fleet.get(&farhad(), "declare", &["Turtlebot4"]);
    let asked: RobotAsset = fleet.get(&farhad(), "robot", &["Turtlebot4"]);
    let listed: Vec<Grant> = fleet.get(&farhad(), "grants", &[TURTLEBOT]);
    assert_eq!((declared.robot.operator, declared.grants), (asked.operator, listed));
    fleet.ok(&farhad(), "declare", &["Turtlebot4"]);
    let writes = fleet.writes.last().unwrap();
    let key = &b"abac\0robot/Turtlebot4"[..];
    assert_eq!(writes.keys().map(|key| &key[..]).collect::<Vec<_>>(), [key]);
    assert_eq!(StateRead::get(&*fleet.state, key).unwrap().as_ref(), writes[key].as_ref());
    fleet.refused(&farhad(), Code::UnknownRobot, "declare", &["Turtlebot5"]);
    let limited = r#"{"mode":"limited","sharing":{"publishers":2}}"#;
    fleet.ok(&owner(), "configure", &[TURTLEBOT, limited]);
    let declared: Declaration = fleet.get(&farhad(), "declare", &["Turtlebot4"]);
    let capabilities = declared.robot.services[0].capabilities().unwrap();
    assert_eq!(
        capabilities.fencing,
        Fencing::PerHolder,
        "a gate learns what follows from a rule that it does not know"
    );
}

#[test]
fn types_of_ros_2_services_and_actions_are_registered() {
    let lamp = robot("Lamp", "exclusive").replace("geometry_msgs/msg/Twist", "std_srvs/srv/SetBool");
    let nav = robot("Nav", "exclusive").replace("geometry_msgs/msg/Twist", "nav2_msgs/action/NavigateToPose");
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "setup", &[&lamp]);
    fleet.ok(&owner(), "setup", &[&nav]);
    for bad in ["std_srvs/srv/", "std_srvs/service/SetBool", "std_srvs/srv/Set Bool", "srv/SetBool"] {
        let bad = robot("Lamp2", "exclusive").replace("geometry_msgs/msg/Twist", bad);
        fleet.refused(&owner(), Code::BadName, "setup", &[&bad]);
    }
}

/// The keys of the index of owners: `ORGANISATION/ROBOT`.
fn index(fleet: &Fleet) -> BTreeSet<String> {
    let prefix = b"abac\0owned/";
    let keys = fleet.state.range(prefix, None, usize::MAX).unwrap();
    keys.iter().map(|(key, _)| String::from_utf8(key[prefix.len()..].to_vec()).unwrap()).collect()
}

#[test]
fn the_index_of_owners_follows_the_robots() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&admin1(), "setup", &[&robot("Spot", "exclusive")]);
    let all = ["Org1/Spot", "Org2/Husky", "Org2/OptiTrack", "Org2/Turtlebot4"];
    assert_eq!(index(&fleet), all.map(str::to_owned).into());
    fleet.ok(&owner(), "remove", &["Husky"]);
    assert!(!index(&fleet).contains("Org2/Husky"));
    fleet.remove_organisation("Org1");
    assert!(!index(&fleet).contains("Org1/Spot"), "{:?}", index(&fleet));
}
