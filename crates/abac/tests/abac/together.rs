//! Several services in one call: all or none.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, farhad, owner, salma};
use ledger_abac::{Acquired, Grant, LineTold};
use ledger_base::rejection::Code;

fn both(fleet: &Fleet) -> Vec<Grant> {
    let grants = fleet.simulate(&owner(), "grants", &[]).unwrap();
    serde_json::from_slice(&grants).unwrap()
}

#[test]
fn all_of_them_are_granted_or_none() {
    let mut fleet = Fleet::of_the_paper();
    let grants: Vec<Grant> = fleet.get(&salma(), "acquire_all", &[r#"{"lease_ms":5000}"#, "Turtlebot4", HUSKY]);
    assert_eq!(grants.iter().map(|grant| grant.service.as_str()).collect::<Vec<_>>(), [TURTLEBOT, HUSKY]);
    assert!(grants.iter().all(|grant| grant.lease_ms == 5000));
    fleet.ok(&salma(), "release", &[HUSKY]);
    // Farhad has no right to Husky, so the other one is not granted either.
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    let refused = fleet.refused(&farhad(), Code::MissingAttribute, "acquire_all", &["{}", TURTLEBOT, HUSKY]);
    let message = "none of Turtlebot4/cmd_vel, Husky/cmd_vel is granted: Org1/Farhad may not acquire Husky/cmd_vel";
    assert!(refused.message.starts_with(message), "{refused}");
    assert!(both(&fleet).is_empty());
    // Salma holds one already: it goes on, with the other.
    let first: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire_all", &["{}", HUSKY, TURTLEBOT]);
    assert_eq!(both(&fleet).iter().find(|grant| grant.service == TURTLEBOT).unwrap().epoch, first.epoch);
}

#[test]
fn who_cannot_have_all_of_them_waits_in_no_line() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"on_conflict":"queue"}}"#]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.refused(&salma(), Code::Held, "acquire_all", &["{}", HUSKY, TURTLEBOT]);
    assert_eq!((fleet.keys("line/"), both(&fleet).len()), (0, 1));
    let confirmed = r#"{"sharing":{"confirm":1},"clear":["on_conflict"]}"#;
    fleet.ok(&owner(), "configure", &[HUSKY, confirmed]);
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    fleet.refused(&salma(), Code::Held, "acquire_all", &["{}", TURTLEBOT, HUSKY]);
    assert_eq!((fleet.keys("pending/"), both(&fleet).len()), (0, 0), "nothing is left of what was refused");
}

#[test]
fn what_is_no_choice_of_services_is_refused() {
    let mut fleet = Fleet::of_the_paper();
    for args in [
        &["{}"][..],
        &["{}", TURTLEBOT, "Turtlebot4"],
        &[r#"{"wait_ms":5}"#, TURTLEBOT],
        &[r#"{"lease_ms":1}"#, TURTLEBOT],
        &["5000", TURTLEBOT],
    ] {
        fleet.refused(&salma(), Code::BadArgument, "acquire_all", args);
    }
    fleet.refused(&salma(), Code::UnknownRobot, "acquire_all", &["{}", TURTLEBOT, "Turtlebot5"]);
    let many = vec![TURTLEBOT; 65];
    fleet.refused(&salma(), Code::BadArgument, "acquire_all", &[&["{}"][..], &many].concat());
}

#[test]
fn a_line_that_a_revoked_contender_leaves_is_told() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"on_conflict":"queue"}}"#]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    assert!(matches!(fleet.get(&farhad(), "acquire", &[TURTLEBOT]), Acquired::Queued { .. }));
    fleet.revoke(&farhad());
    assert_eq!(fleet.newest::<LineTold>("line").waiting, 0);
}
