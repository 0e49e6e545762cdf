//! Reports that somebody publishes on a robot's own topic, around the ledger.

use crate::fleet::{Fleet, SECOND, TURTLEBOT, admin1, camera, farhad, identity, owner, robot, salma};
use ledger_abac::{RobotAsset, SideDoor};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

const REPORT: &str = "report_side_door";

fn turtlebot() -> Identity {
    identity("Org2", "Turtlebot4", Role::Robot, &[], 70)
}

/// The report that stands with the robot's service.
fn shown(fleet: &mut Fleet) -> Option<SideDoor> {
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Turtlebot4"]);
    asset.services.into_iter().next().unwrap().side_door
}

#[test]
fn a_side_door_is_told_to_all_members_and_stays_on_record_until_it_is_closed() {
    let mut fleet = Fleet::of_the_paper();
    assert_eq!(shown(&mut fleet), None);
    let report: SideDoor = fleet.get(&turtlebot(), REPORT, &[TURTLEBOT, "/base/cmd_vel", "2"]);
    assert_eq!((report.topic.as_str(), report.publishers, report.by.as_str()), ("/base/cmd_vel", 2, "Org2/Turtlebot4"));
    assert_eq!(fleet.newest::<SideDoor>("side_door"), report);
    let event = fleet.events.last().unwrap();
    assert_eq!((event.chaincode.as_str(), event.subject.as_str()), ("abac", TURTLEBOT));

    fleet.forget();
    fleet.time += 3600 * SECOND;
    assert_eq!(shown(&mut fleet), Some(report.clone()), "it outlives time and the node's memory");
    let again: SideDoor = fleet.get(&turtlebot(), REPORT, &[TURTLEBOT, "/base/cmd_vel", "1"]);
    assert_eq!((again.since, again.publishers), (report.since, 1));
    assert!(again.at > report.at + 3600 * SECOND);
    fleet.time += 60 * SECOND;
    let closed: SideDoor = fleet.get(&turtlebot(), REPORT, &[TURTLEBOT, "/base/cmd_vel", "0"]);
    assert_eq!((closed.since, closed.publishers), (report.since, 0));
    fleet.time += 60 * SECOND;
    fleet.refused(&turtlebot(), Code::BadArgument, REPORT, &[TURTLEBOT, "/base/cmd_vel", "0"]);
    let anew: SideDoor = fleet.get(&turtlebot(), REPORT, &[TURTLEBOT, "/base/cmd_vel", "1"]);
    assert_eq!(anew.since, anew.at, "another side door has a beginning of its own");
}

#[test]
fn side_doors_are_reported_by_the_robot_itself_and_by_nodes_of_its_owner_only() {
    let mut fleet = Fleet::of_the_paper();
    let node = identity("Org2", "node2", Role::Node, &[], 80);
    for may_not in [
        salma(),
        farhad(),
        admin1(),
        owner(),
        camera(),
        identity("Org1", "Turtlebot4", Role::Robot, &[], 81),
        identity("Org2", "Turtlebot4", Role::Member, &["Turtlebot4"], 82),
        identity("Org1", "node1", Role::Node, &[], 83),
    ] {
        let refused = fleet.refused(&may_not, Code::NotOwner, REPORT, &[TURTLEBOT, "/cmd_vel", "1"]);
        assert!(refused.wanted.contains("Org2/Turtlebot4"), "{refused}");
    }
    // No policy permits or forbids it: the owner has put both beside the robot.
    fleet.ok(&owner(), "policy", &["put", "p", "forbid (principal, action, resource);"]);
    for may in [turtlebot(), node] {
        fleet.ok(&may, REPORT, &[TURTLEBOT, "/cmd_vel", "1"]);
        fleet.time += 60 * SECOND;
    }
}

#[test]
fn a_topic_has_at_most_one_report_in_a_minute_whoever_reports() {
    let mut fleet = Fleet::of_the_paper();
    let husky = identity("Org2", "Husky", Role::Robot, &[], 71);
    let node = identity("Org2", "node2", Role::Node, &[], 80);
    fleet.ok(&turtlebot(), REPORT, &[TURTLEBOT, "/cmd_vel", "1"]);
    // Every call takes a millisecond of block time.
    fleet.time += 59 * SECOND;
    for who in [turtlebot(), node] {
        let refused = fleet.refused(&who, Code::LimitExceeded, REPORT, &[TURTLEBOT, "/cmd_vel", "0"]);
        assert!(refused.found.contains("Org2/Turtlebot4 59 s ago"), "{refused}");
    }
    fleet.ok(&husky, REPORT, &["Husky/cmd_vel", "/cmd_vel", "1"]);
    fleet.time += SECOND;
    fleet.ok(&turtlebot(), REPORT, &[TURTLEBOT, "/cmd_vel", "0"]);
    let reports = fleet.events.iter().filter(|event| event.name == "side_door").count();
    assert_eq!(reports, 3);
}

#[test]
fn only_command_services_have_a_side_door_and_arguments_are_bounded() {
    let mut fleet = Fleet::of_the_paper();
    fleet.refused(&camera(), Code::BadArgument, REPORT, &["OptiTrack/poses", "/poses", "1"]);
    let long = format!("/{}", "a".repeat(300));
    for (topic, publishers) in [("/cmd_vel", "65536"), ("/cmd_vel", "-1"), ("/cmd_vel", ""), ("/cmd_vel", "0")] {
        fleet.refused(&turtlebot(), Code::BadArgument, REPORT, &[TURTLEBOT, topic, publishers]);
    }
    for topic in ["cmd_vel", "/cmd vel", "/", &long] {
        fleet.refused(&turtlebot(), Code::BadName, REPORT, &[TURTLEBOT, topic, "1"]);
    }
    fleet.refused(&turtlebot(), Code::BadArgument, REPORT, &[TURTLEBOT, "/cmd_vel"]);
    fleet.refused(&turtlebot(), Code::UnknownService, REPORT, &["Turtlebot4/arm", "/arm", "1"]);
    fleet.ok(&turtlebot(), REPORT, &[TURTLEBOT, "/cmd_vel", "65535"]);
}

#[test]
fn a_service_that_is_taken_away_leaves_no_report() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&turtlebot(), REPORT, &[TURTLEBOT, "/cmd_vel", "1"]);
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"max_age_ms":400}"#]);
    assert!(shown(&mut fleet).is_some(), "a change of the service leaves it");
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "exclusive")]);
    assert_eq!(shown(&mut fleet), None);

    fleet.ok(&turtlebot(), REPORT, &[TURTLEBOT, "/cmd_vel", "1"]);
    let other = robot("Turtlebot4", "exclusive").replace("/cmd_vel", "/other");
    fleet.ok(&owner(), "replace", &[&other]);
    fleet.ok(&owner(), "replace", &[&robot("Turtlebot4", "exclusive")]);
    assert_eq!(shown(&mut fleet), None);
}
