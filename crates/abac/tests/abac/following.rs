//! Following: a subscription is allowed or refused when somebody subscribes, before there is an event.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, camera, farhad, owner, robot, salma};
use ledger_base::rejection::Code;

const BRIDGE: [&str; 5] = ["message", "granted", "renewed", "released", "robot"];

#[test]
fn who_may_not_read_the_messages_of_a_service_may_not_follow_them() {
    let fleet = Fleet::of_the_paper();
    fleet.may_follow(&salma(), &[TURTLEBOT, HUSKY], &["message"]).unwrap();
    fleet.may_follow(&farhad(), &[TURTLEBOT], &["message"]).unwrap();
    let refused = fleet.may_follow(&farhad(), &[TURTLEBOT, HUSKY], &["message"]).unwrap_err();
    assert_eq!(refused.code, Code::MissingAttribute);
    assert!(refused.message.contains("may not subscribe to Husky/cmd_vel"), "{refused}");
    fleet.may_follow(&farhad(), &[HUSKY], &BRIDGE).unwrap_err();
}

#[test]
fn what_everybody_may_know_everybody_may_follow() {
    let fleet = Fleet::of_the_paper();
    fleet.may_follow(&farhad(), &[HUSKY], &["granted", "released"]).unwrap();
    fleet.may_follow(&farhad(), &[HUSKY], &[]).unwrap();
    fleet.may_follow(&farhad(), &[], &["message"]).unwrap();
}

#[test]
fn a_service_that_does_not_exist_is_refused_unless_one_waits_for_its_robot() {
    let mut fleet = Fleet::of_the_paper();
    for (subject, code) in [("Nope/cmd_vel", Code::UnknownRobot), ("Husky/arm", Code::UnknownService)] {
        assert_eq!(fleet.may_follow(&camera(), &[subject], &["message"]).unwrap_err().code, code);
        fleet.may_follow(&camera(), &[subject, "Nope"], &BRIDGE).unwrap();
    }
    let refused = fleet.may_follow(&salma(), &["Husky"], &["message"]).unwrap_err();
    assert_eq!((refused.code, refused.advice()), (Code::UnknownService, "subscribe to Husky/cmd_vel"));
    fleet.ok(&owner(), "remove", &["Husky"]);
    assert_eq!(fleet.may_follow(&salma(), &[HUSKY], &["message"]).unwrap_err().code, Code::UnknownRobot);
}

#[test]
fn a_right_that_a_change_takes_away_is_missing_at_once() {
    let mut fleet = Fleet::of_the_paper();
    fleet.may_follow(&farhad(), &[TURTLEBOT], &["message"]).unwrap();
    fleet.ok(&owner(), "replace", &[&robot("Turtlebot4", "open").replacen("\"Turtlebot4\",\n", "\"licence\",\n", 1)]);
    assert_eq!(fleet.may_follow(&farhad(), &[TURTLEBOT], &["message"]).unwrap_err().code, Code::MissingAttribute);
    fleet.ok(&owner(), "policy", &["put", "all", "permit (principal, action, resource);"]);
    fleet.may_follow(&farhad(), &[TURTLEBOT], &["message"]).unwrap();
}
