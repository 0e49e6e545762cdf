//! Services in open mode.

use crate::fleet::{Fleet, HUSKY, TURTLEBOT, farhad, owner, robot, salma};
use ledger_abac::{Grant, Mode, Reason, Released, RobotAsset};
use ledger_base::rejection::Code;

fn open() -> Fleet {
    let mut fleet = Fleet::empty();
    fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "open"), &robot("Husky", "open")]);
    fleet
}

#[test]
fn everybody_whom_policies_permit_publishes_without_a_grant() {
    let mut fleet = open();
    for seq in 1..=3 {
        fleet.set(&salma(), TURTLEBOT, 0, seq, 1).unwrap();
        fleet.set(&farhad(), TURTLEBOT, 0, seq, 1).unwrap();
    }
    fleet.set_refused(&farhad(), Code::MissingAttribute, HUSKY, 0, 1);
    // Each publisher counts alone.
    fleet.set_refused(&salma(), Code::StaleSequence, TURTLEBOT, 0, 3);
    fleet.set(&farhad(), TURTLEBOT, 0, 9, 1).unwrap();
    fleet.set(&salma(), TURTLEBOT, 0, 4, 1).unwrap();
}

#[test]
fn a_grant_is_given_to_many_and_its_epoch_counts_on_the_publishers_sequence() {
    let mut fleet = open();
    fleet.set(&salma(), TURTLEBOT, 0, 5, 1).unwrap();
    let first: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    let second: Grant = fleet.get(&farhad(), "acquire", &[TURTLEBOT]);
    assert_eq!((first.epoch, first.mode.clone(), first.next_seq), (1, Mode::OPEN, 6));
    assert_eq!((second.epoch, second.next_seq), (2, 0));
    fleet.set(&salma(), TURTLEBOT, 1, 6, 1).unwrap();
    fleet.set(&farhad(), TURTLEBOT, 2, 0, 1).unwrap();
    fleet.set_refused(&salma(), Code::StaleSequence, TURTLEBOT, 0, 6);
    fleet.set_refused(&salma(), Code::StaleEpoch, TURTLEBOT, 2, 7);
    let asset: RobotAsset = fleet.get(&salma(), "robot", &["Turtlebot4"]);
    assert_eq!(asset.services[0].holders, ["Org1/Salma", "Org1/Farhad"]);
    assert_eq!((asset.operator.as_str(), asset.under_operation), ("Org1/Salma", true));

    let taken: Vec<Released> = fleet.get(&owner(), "release", &[TURTLEBOT, "Org1/Salma"]);
    assert_eq!(taken.iter().map(|r| r.holder.as_str()).collect::<Vec<_>>(), ["Org1/Salma"]);
    fleet.set_refused(&salma(), Code::StaleEpoch, TURTLEBOT, 1, 7);
}

#[test]
fn a_service_that_becomes_exclusive_keeps_its_oldest_holder() {
    let mut fleet = open();
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&owner(), "replace", &[&robot("Turtlebot4", "exclusive")]);
    let released: Released = fleet.newest("released");
    assert_eq!((released.holder.as_str(), released.reason.known()), ("Org1/Salma", Some(Reason::Taken)));
    let grants: Vec<Grant> = fleet.get(&salma(), "grants", &[TURTLEBOT]);
    assert_eq!((grants.len(), grants[0].holder.as_str(), grants[0].mode.clone()), (1, "Org1/Farhad", Mode::EXCLUSIVE));
    fleet.set(&farhad(), TURTLEBOT, 1, 1, 1).unwrap();
}
