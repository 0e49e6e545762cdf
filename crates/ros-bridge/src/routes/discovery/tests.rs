//! Routes that are offered for the robots on a ledger.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use std::path::Path;

use ledger_base::settings::Fault;
use ledger_contract::RobotAsset;
use serde_json::json;

use super::{Settings, offer::candidates};
use crate::Config;

fn parse(text: &str) -> Result<Settings, Vec<Fault>> {
    let text = format!("[discover]\n{text}");
    Config::parse(&text, Path::new("bridge.toml"), |_| ()).map(|config| config.discover.unwrap())
}

/// A robot with services `TOPIC` and `<TOPIC`, the latter a feed.
fn robot(organisation: &str, name: &str, topics: &[&str]) -> RobotAsset {
    let service = |topic: &&str| {
        let (direction, topic) = topic.strip_prefix('<').map_or(("command", *topic), |topic| ("feed", topic));
        json!({
            "service": format!("{name}{topic}"), "robot": name, "organisation": organisation, "topic": topic,
            "type": "geometry_msgs/msg/Twist", "mode": "exclusive", "direction": direction, "max_age_ms": 1000,
            "lease_ms": 10000, "lease_ms_max": 600_000, "stop_hex": null, "holder": "", "holders": [], "epoch": 3,
            "expires": 0, "capabilities": { "fencing": "newest", "publishing": "grant", "sequence": "per_epoch" },
        })
    };
    serde_json::from_value(json!({
        "Name": name, "SubTopic": "", "PubTopic": "", "owner": "", "UnderOp": false, "organisation": organisation,
        "attribute_required": "", "trusted": [], "services": topics.iter().map(service).collect::<Vec<_>>(),
    }))
    .unwrap()
}

/// The routes as `DIRECTION TOPIC`, and the services without one.
fn offered(settings: &str, robots: &[RobotAsset]) -> (Vec<String>, Vec<String>) {
    let (found, left) = candidates(&parse(settings).unwrap(), robots);
    let text = found
        .iter()
        .map(|candidate| format!("{} {}", candidate.route.kind.name, candidate.route.topic.as_ref().unwrap()));
    (text.collect(), left.into_iter().map(|left| format!("{}: {}", left.service, left.reason)).collect())
}

fn fleet() -> [RobotAsset; 2] {
    [robot("Org2", "Arm", &["/grip"]), robot("Org2", "Rover", &["/cmd_vel", "</odom"])]
}

#[test]
fn a_users_bridge_takes_commands_and_delivers_feeds_under_the_name_of_the_robot() {
    let (offers, left) = offered("", &fleet());
    assert_eq!(offers, ["to_ledger /Arm/grip", "to_ledger /Rover/cmd_vel", "from_ledger /Rover/odom"]);
    assert_eq!(left, [""; 0]);
    assert_eq!(offered("namespace = '/fleet/a'", &fleet()).0[1], "to_ledger /fleet/a/Rover/cmd_vel");
    assert_eq!(offered("namespace = '/'", &fleet()).0[1], "to_ledger /Rover/cmd_vel");
    let remap = "namespace = '/fleet'\nremap = { 'Rover/cmd_vel' = '/cmd_vel' }";
    assert_eq!(offered(remap, &fleet()).0[1..], ["to_ledger /cmd_vel", "from_ledger /fleet/Rover/odom"]);
}

#[test]
fn a_robots_bridge_has_its_own_services_the_other_way_round_under_their_own_topics() {
    let offers = |more: &str| offered(&format!("robot = 'Rover'\n{more}"), &fleet()).0;
    assert_eq!(offers(""), ["from_ledger /cmd_vel", "to_ledger /odom"]);
    assert_eq!(offers("namespace = '/base'"), ["from_ledger /base/cmd_vel", "to_ledger /base/odom"]);
    let (none, left) = offered("robot = 'Rovr'", &fleet());
    assert_eq!((none.len(), left), (0, vec!["Rovr: no robot of this name is registered".to_owned()]));
}

#[test]
fn expressions_choose_services_by_direction_and_what_is_denied_is_denied_also_where_it_is_allowed() {
    let offers = |settings: &str| offered(settings, &fleet()).0;
    assert_eq!(offers("allow = { to_ledger = ['Rover/.*'] }"), ["to_ledger /Rover/cmd_vel", "from_ledger /Rover/odom"]);
    assert_eq!(offers("allow = { to_ledger = [] }"), ["from_ledger /Rover/odom"]);
    assert_eq!(offers("deny = { to_ledger = ['.*'] }"), ["from_ledger /Rover/odom"]);
    assert_eq!(offers("deny = { from_ledger = ['.*'] }\nallow = { from_ledger = ['Rover/odom'] }").len(), 2);
    assert_eq!(offers("allow = { to_ledger = ['Rover'], from_ledger = ['odom'] }"), [""; 0], "whole ids");
}

#[test]
fn limits_are_those_of_the_first_expression_that_matches() {
    let settings = parse("max_rate_hz = ['Rover/.*=7', '.*=9']\nsample_bytes_max = ['Arm/.*=4096']").unwrap();
    let (found, _) = candidates(&settings, &fleet());
    let of = |service: &str| found.iter().find(|candidate| candidate.route.service == service).unwrap();
    for (service, rate, bytes) in [("Rover/cmd_vel", 7, 4 << 20), ("Arm/grip", 9, 4096), ("Rover/odom", 7, 4 << 20)] {
        let route = &of(service).route;
        assert!(format!("{:?}", route.plan).contains(&format!("max_rate_hz: Some({rate})")), "{route:?}");
        assert_eq!(route.sample_bytes_max, bytes);
    }
    let robots = parse("robot = 'Rover'\nmax_rate_hz = ['.*=9']").unwrap();
    let (found, _) = candidates(&robots, &fleet());
    let of = |service: &str| found.iter().find(|candidate| candidate.route.service == service).unwrap();
    assert!(format!("{:?}", of("Rover/odom").route.plan).contains("max_rate_hz: Some(9)"));
    assert!(
        format!("{:?}", of("Rover/cmd_vel").route.plan).contains("max_rate_hz: None"),
        "no command is thinned out here"
    );
}

#[test]
fn nothing_is_submitted_without_the_grant_that_a_service_asks_for() {
    let mut rover = robot("Org2", "Rover", &["/cmd_vel"]);
    let plan = |rover: &RobotAsset| {
        let (found, _) = candidates(&Settings::default(), std::slice::from_ref(rover));
        format!("{:?}", found[0].route.plan)
    };
    assert!(plan(&rover).contains("held_only: true"));
    let mut set = |mode: &str, capabilities| {
        rover.services[0].mode = serde_json::from_value(json!(mode)).unwrap();
        rover.services[0].capabilities = serde_json::from_value(capabilities).unwrap();
        plan(&rover)
    };
    let open = set("open", json!({ "fencing": "per_holder", "publishing": "policy", "sequence": "per_epoch" }));
    assert!(open.contains("held_only: false"), "the route of an open service is another one");
    let unknown = set("by_magic", json!({ "places": "2" }));
    assert!(unknown.contains("held_only: true"), "a rule that this version does not know");
}

#[test]
fn a_name_that_ros_does_not_allow_becomes_the_nearest_and_displaces_nobody() {
    let named = |names: &[&str]| {
        let robots: Vec<_> = names.iter().map(|name| robot("Org2", name, &["/cmd_vel"])).collect();
        offered("", &robots)
    };
    assert_eq!(named(&["TB4-1.a"]).0, ["to_ledger /TB4_1_a/cmd_vel"]);
    let (offers, left) = named(&["a-b", "a_b"]);
    assert_eq!(offers, ["to_ledger /a_b/cmd_vel"]);
    assert!(left[0].starts_with("a-b/cmd_vel: a-b/cmd_vel and a_b/cmd_vel would share"), "{left:?}");
    let (offers, left) = named(&["a-b", "a.b", "007"]);
    assert_eq!((offers.len(), left.len()), (0, 3), "neither is taken for the other: {left:?}");
    assert!(left.iter().any(|left| left.contains("no topic name of ROS 2")), "{left:?}");
}

#[test]
fn organisations_take_turns_so_that_one_with_many_robots_leaves_room() {
    let mut robots: Vec<_> = (0..100).map(|number| robot("Evil", &format!("A{number}"), &["/x"])).collect();
    robots.push(robot("Org2", "Rover", &["/cmd_vel"]));
    assert_eq!(offered("", &robots).0[1], "to_ledger /Rover/cmd_vel");
}

#[test]
fn services_and_actions_have_routes_of_their_kinds_and_their_replies_none() {
    let mut rover = robot("Org2", "Rover", &["/plan", "</plan/_reply", "/go", "</go/_reply"]);
    for (number, name) in (0..).zip(["nav_msgs/srv/GetPlan", "nav2_msgs/action/NavigateToPose"]) {
        rover.services[2 * number].type_name = name.to_owned();
        rover.services[2 * number + 1].type_name = name.to_owned();
    }
    let offers = |settings: &str| offered(settings, std::slice::from_ref(&rover));
    assert_eq!(offers("").0, ["action_server /Rover/go", "service_server /Rover/plan"]);
    assert_eq!(offers("robot = 'Rover'").0, ["action_client /go", "service_client /plan"]);
    assert_eq!(offers("deny = { service_server = ['.*'] }"), (vec!["action_server /Rover/go".to_owned()], vec![]));
    assert_eq!(offers("allow = { to_ledger = [] }").0.len(), 2, "each kind has a list of its own");
}

#[test]
fn a_service_of_no_type_of_ros_or_of_a_direction_that_is_not_known_has_no_route() {
    let mut rover = robot("Org2", "Rover", &["/cmd_vel", "/plan", "/new"]);
    rover.services[1].type_name = "nav_msgs/GetPlan".to_owned();
    rover.services[2].direction = serde_json::from_value(json!("sideways")).unwrap();
    let (offers, left) = offered("", &[rover]);
    assert_eq!(offers, ["to_ledger /Rover/cmd_vel"]);
    assert_eq!(left, ["Rover/plan: \"nav_msgs/GetPlan\" is no type of ROS 2"]);
}

#[test]
fn every_fault_of_the_section_is_named_with_its_line_and_both_keys() {
    let text = "robot = 'Rover'\nnamespace = 'fleet'\nallow = { to_ledger = ['('], upwards = [] }\n\
                deny = { from_ledger = 'all' }\nmax_rate_hz = ['.*=0', '.*=5']\n\
                remap = { 'Rover' = '/x', 'Rover/a' = '/b', 'Rover/c' = '/b', 'Arm/c' = '/d' }";
    let told: Vec<String> = parse(text).unwrap_err().iter().map(ToString::to_string).collect();
    let wanted = [
        (3, "discover.namespace: ", "\"/fleet\""),
        (4, "discover.allow.to_ledger: this is no usable regular expression", "\"(\""),
        (4, "[discover.allow] has no setting \"upwards\"", "to_ledger"),
        (5, "discover.deny.from_ledger has a wrong value", "at most 64 texts"),
        (6, "discover.max_rate_hz: this is no limit", "from 1 to 10000"),
        (7, "discover.remap.\"Rover\": this names no service", "ROBOT/TOPIC"),
        (7, "discover.remap.\"Arm/c\" does not fit discover.robot", "services of Rover"),
        (7, "discover.remap.\"Rover/c\" does not fit discover.remap.\"Rover/a\"", "both on /b"),
    ];
    for (line, fault, hint) in wanted {
        let found = told.iter().find(|told| told.starts_with(&format!("bridge.toml:{line}: {fault}")));
        assert!(found.is_some_and(|told| told.contains(hint)), "{line} {fault}: {told:#?}");
    }
    assert_eq!(told.len(), wanted.len(), "{told:#?}");
}

#[test]
fn a_bridge_that_discovers_needs_no_route() {
    assert!(parse("").is_ok());
    assert!(Config::parse("", Path::new(""), |_| ()).is_err());
}
