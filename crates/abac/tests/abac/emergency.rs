//! Stop, resume and take.

use crate::fleet::{
    EXECUTED, Fleet, HUSKY, OPTITRACK, SECOND, TURTLEBOT, admin1, camera, farhad, identity, owner, robot, salma,
};
use ledger::CallRef;
use ledger_abac::{Declaration, Emergency, EmergencyAnswer, Grant, Reason, Released, RobotAsset};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

fn safety(organisation: &str, serial: u8) -> Identity {
    identity(organisation, "Safety", Role::Member, &["safety"], serial)
}

fn permit_all(fleet: &mut Fleet) {
    fleet.ok(&owner(), "policy", &["put", "p", "permit (principal, action, resource);"]);
}

#[test]
fn a_stop_ends_every_command_and_nobody_acquires_until_the_robot_is_resumed() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let stopped: EmergencyAnswer = fleet.get(&owner(), "stop", &["Turtlebot4", "person in the cell"]);
    assert_eq!((stopped.robots.as_slice(), stopped.ended.len()), (&["Turtlebot4".to_owned()][..], 1));
    assert_eq!(fleet.newest::<Released>("released").reason.known(), Some(Reason::Stopped));
    let told: Emergency = fleet.newest("stopped");
    assert_eq!((told.by.as_str(), told.reason.as_str()), ("Org2/admin", "person in the cell"));

    fleet.set_refused(&salma(), Code::Stopped, TURTLEBOT, 1, 1);
    let refused = fleet.refused(&salma(), Code::Stopped, "acquire", &[TURTLEBOT]);
    assert!(refused.found.contains("Org2/admin") && refused.found.contains("person in the cell"), "{refused}");
    fleet.refused(&owner(), Code::Stopped, "take", &[TURTLEBOT, "I want it"]);
    fleet.set(&salma(), HUSKY, 1, 1, 1).unwrap();

    // It outlives the node's memory, time, and the robot's registration.
    fleet.forget();
    fleet.time += 3600 * SECOND;
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "exclusive")]);
    fleet.refused(&salma(), Code::Stopped, "acquire", &[TURTLEBOT]);
    let asset: RobotAsset = fleet.get(&owner(), "robot", &["Turtlebot4"]);
    assert_eq!(asset.stopped.unwrap().reason, "person in the cell");

    let again: EmergencyAnswer = fleet.get(&owner(), "stop", &["Turtlebot4", "another reason"]);
    assert_eq!((again.robots.len(), again.unchanged.len()), (0, 1));
    let resumed: EmergencyAnswer = fleet.get(&owner(), "resume", &["Turtlebot4"]);
    assert_eq!(resumed.robots, ["Turtlebot4"]);
    assert_eq!(fleet.get::<Grant>(&salma(), "acquire", &[TURTLEBOT]).epoch, 2);
}

#[test]
fn who_publishes_by_policy_is_stopped_too_and_a_feed_goes_on() {
    let mut fleet = Fleet::empty();
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "open"), OPTITRACK]);
    fleet.set(&salma(), TURTLEBOT, 0, 1, 1).unwrap();
    fleet.ok(&owner(), "stop", &["*"]);
    fleet.set_refused(&salma(), Code::Stopped, TURTLEBOT, 0, 2);
    fleet.set(&camera(), "OptiTrack/poses", 0, 1, 1).unwrap();
    fleet.ok(&owner(), "resume", &["*"]);
    fleet.set(&salma(), TURTLEBOT, 0, 2, 1).unwrap();
}

#[test]
fn robots_are_stopped_by_their_owner_by_safety_officers_whom_it_trusts_and_by_themselves() {
    let mut fleet = Fleet::of_the_paper();
    let turtlebot = identity("Org2", "Turtlebot4", Role::Robot, &[], 70);
    let impostor = identity("Org1", "Turtlebot4", Role::Robot, &[], 71);
    for may in [owner(), safety("Org1", 72), turtlebot.clone()] {
        fleet.ok(&may, "stop", &["Turtlebot4"]);
        fleet.ok(&owner(), "resume", &["Turtlebot4"]);
    }
    for may_not in [salma(), admin1(), camera(), impostor, safety("Org3", 73)] {
        let refused = fleet.refused(&may_not, Code::DeniedByPolicy, "stop", &["Turtlebot4"]);
        assert!(refused.wanted.contains("an admin of Org2"), "{refused}");
    }
    fleet.refused(&safety("Org3", 73), Code::DeniedByPolicy, "stop", &["*"]);
    // The right to stop is not the right to resume.
    fleet.ok(&turtlebot, "stop", &["Turtlebot4"]);
    for may_not in [turtlebot, safety("Org1", 72), admin1()] {
        fleet.refused(&may_not, Code::DeniedByPolicy, "resume", &["Turtlebot4"]);
    }
    fleet.refused(&owner(), Code::UnknownRobot, "stop", &["Turtelbot4"]);
}

#[test]
fn policies_say_who_else_may_and_never_lock_the_owner_out() {
    let mut fleet = Fleet::of_the_paper();
    let text = "permit (principal, action == Action::\"resume\", resource == Robot::\"Husky\")
        when { principal.hasTag(\"Turtlebot4\") && resource.trusted.contains(principal.organisation) };
        forbid (principal, action, resource) when { principal.role == \"admin\" };";
    fleet.ok(&owner(), "policy", &["put", "p", text]);
    fleet.ok(&owner(), "stop", &["*"]);
    fleet.ok(&salma(), "resume", &["Husky"]);
    fleet.refused(&salma(), Code::DeniedByPolicy, "resume", &["Turtlebot4"]);
    fleet.ok(&owner(), "resume", &["*"]);
    fleet.ok(&owner(), "take", &[HUSKY, "mine"]);
}

#[test]
fn all_robots_are_those_that_the_caller_may_stop() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&admin1(), "setup", &[&robot("Spot", "exclusive")]);
    let stopped: EmergencyAnswer = fleet.get(&owner(), "stop", &["*"]);
    assert_eq!(stopped.robots, ["Husky", "OptiTrack", "Turtlebot4"]);
    let stopped: EmergencyAnswer = fleet.get(&safety("Org1", 72), "stop", &["*", "drill"]);
    assert_eq!((stopped.robots, stopped.unchanged.len()), (vec!["Spot".to_owned()], 3));
}

#[test]
fn a_service_is_taken_whatever_its_rule_says_and_nobody_preempts_the_taker() {
    let mut fleet = Fleet::of_the_paper();
    let preempt = r#"{"sharing":{"on_conflict":"preempt","queue_max":4,"aging_ms":100}}"#;
    fleet.ok(&owner(), "configure", &[TURTLEBOT, preempt]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "take", &[TURTLEBOT, "I want it"]);
    let grant: Grant = fleet.get(&owner(), "take", &[TURTLEBOT, "person in the cell", "60000"]);
    assert_eq!((grant.epoch, grant.taken.as_deref()), (2, Some("person in the cell")));
    let released: Released = fleet.newest("released");
    assert_eq!((released.reason.known(), released.by.as_deref()), (Some(Reason::Overridden), Some("Org2/admin")));
    fleet.set_refused(&salma(), Code::StaleEpoch, TURTLEBOT, 1, 1);
    fleet.set(&owner(), TURTLEBOT, 2, 1, 1).unwrap();

    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.time += 30 * SECOND;
    fleet.tick();
    fleet.set(&owner(), TURTLEBOT, 2, 2, 1).unwrap();
    // The owner's admin holds it by another right than `acquire`: a change of policies does not end that.
    permit_all(&mut fleet);
    fleet.ok(
        &owner(),
        "policy",
        &["put", "p", "permit (principal, action, resource) when { principal.name == \"Farhad\" };"],
    );
    fleet.set(&owner(), TURTLEBOT, 2, 3, 1).unwrap();
    fleet.ok(&owner(), "release", &[TURTLEBOT]);
    fleet.tick();
    assert_eq!(fleet.newest::<Grant>("granted").holder, "Org1/Farhad");
}

#[test]
fn whoever_waits_keeps_the_place_while_the_robot_is_stopped_and_has_its_turn_after() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"on_conflict":"queue"}}"#]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.ok(&owner(), "stop", &["Turtlebot4"]);
    for _ in 0..3 {
        fleet.time += 20 * SECOND;
        fleet.tick();
    }
    assert_eq!(fleet.newest::<Grant>("granted").holder, "Org1/Salma", "nobody since");
    fleet.ok(&owner(), "resume", &["Turtlebot4"]);
    fleet.tick();
    assert_eq!(fleet.newest::<Grant>("granted").holder, "Org1/Farhad");
}

/// A stop that was signed now.
fn signed(fleet: &Fleet, number: u8) -> CallRef {
    CallRef { id: Hash([number; 32]), not_after: fleet.time + 30 * SECOND }
}

#[test]
fn a_declaration_lists_the_named_stops_that_are_settled_and_no_others() {
    let mut fleet = Fleet::of_the_paper();
    let (open, over) = (signed(&fleet, 1), CallRef { not_after: fleet.time - 1, ..signed(&fleet, 2) });
    let executed = CallRef { id: EXECUTED, ..open };
    let named = [open, over, executed].map(|call| call.to_string());
    let args = ["Turtlebot4", &named[0], &named[1], &named[2]];
    let declared: Declaration = fleet.get(&farhad(), "declare", &args);
    assert_eq!(declared.settled, [over.id.to_string(), EXECUTED.to_string()]);
    fleet.time = open.not_after + 1;
    let declared: Declaration = fleet.get(&farhad(), "declare", &["Turtlebot4", &named[0]]);
    assert_eq!(declared.settled, [open.id.to_string()], "its time has passed");
    fleet.refused(&farhad(), Code::BadArgument, "declare", &["Turtlebot4", "0102"]);
}

#[test]
fn a_resume_cancels_the_stops_that_it_names_before_they_are_ordered_and_no_others() {
    let mut fleet = Fleet::of_the_paper();
    let [first, second] = [signed(&fleet, 1), signed(&fleet, 2)];
    let (robots, call) = (["Turtlebot4".to_owned()], first.to_string());
    let resumed: EmergencyAnswer = fleet.get(&owner(), "resume", &["Turtlebot4", "", &call]);
    assert_eq!(resumed.robots, robots, "also if it is not stopped yet");
    fleet.newest::<Emergency>("resumed");
    let declared: Declaration = fleet.get(&farhad(), "declare", &["Turtlebot4", &call, &second.to_string()]);
    assert_eq!(declared.settled, [first.id.to_string()]);
    let elsewhere: Declaration = fleet.get(&farhad(), "declare", &["Husky", &call]);
    assert!(elsewhere.settled.is_empty(), "it was cancelled for the one robot");

    fleet.transaction = first.id;
    fleet.refused(&owner(), Code::Refused, "stop", &["Turtlebot4"]);
    let others: EmergencyAnswer = fleet.get(&owner(), "stop", &["*"]);
    assert_eq!(others.robots, ["Husky", "OptiTrack"]);
    fleet.transaction = second.id;
    let stopped: EmergencyAnswer = fleet.get(&owner(), "stop", &["Turtlebot4"]);
    assert_eq!(stopped.robots, robots);

    let nothing: EmergencyAnswer = fleet.get(&owner(), "resume", &["OptiTrack", "drill"]);
    assert_eq!(nothing.robots.len(), 1);
    fleet.time += 200 * SECOND;
    let late: EmergencyAnswer = fleet.get(&owner(), "resume", &["OptiTrack", "drill", &call]);
    assert_eq!(late.unchanged.len(), 1, "it is over");
}
