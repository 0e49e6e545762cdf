//! Places of subscribers: as many read a service at once as its owner says.

use crate::fleet::{Fleet, HUSKY, SECOND, TURTLEBOT, camera, farhad, identity, owner, salma};
use ledger_abac::{Acquired, Authorization, Grant, Left, LeftReason, Limits, LineState, Reason, Released, RobotAsset};
use ledger_base::rejection::Code;
use ledger_contract::RobotChange;
use ledger_identity::{Identity, Role};
use ledger_storage::result::Event;

/// The places of Turtlebot4's subscribers.
const PLACES: &str = "Turtlebot4/cmd_vel:subscribe";

fn third() -> Identity {
    identity("Org1", "Third", Role::Member, &["Turtlebot4"], 61)
}

fn fleet(settings: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, settings]);
    fleet
}

/// One reads at a time.
fn one() -> Fleet {
    fleet(r#"{"mode":"limited","sharing":{"subscribers":1}}"#)
}

/// A queue before one place.
fn one_with_line() -> Fleet {
    fleet(r#"{"mode":"limited","sharing":{"subscribers":1,"publishers":1,"on_conflict":"queue"}}"#)
}

fn reads(fleet: &Fleet, who: &Identity) -> Result<(), Code> {
    let message =
        Event { chaincode: "abac".into(), name: "message".into(), subject: TURTLEBOT.into(), payload: "".into() };
    let follows = fleet.may_follow(who, &[TURTLEBOT], &["message"]).map_err(|refused| refused.code);
    assert_eq!(fleet.may_read(who, &message).map_err(|refused| refused.code), follows, "one decision for both");
    follows
}

fn told(fleet: &Fleet, who: &Identity) -> Authorization {
    let answer = fleet.simulate(who, "authorize", &[TURTLEBOT.into(), "subscribe".into()]).unwrap();
    serde_json::from_slice(&answer).unwrap()
}

#[test]
fn one_more_subscriber_than_the_owner_allows_is_refused_and_reads_nothing() {
    let mut fleet = one();
    assert_eq!(reads(&fleet, &salma()), Err(Code::NotHolder));
    assert_eq!((told(&fleet, &salma()).allowed, told(&fleet, &salma()).name.as_str()), (false, "NOT_HOLDER"));
    let refused = fleet.may_follow(&salma(), &[TURTLEBOT], &["message"]).unwrap_err();
    assert_eq!(refused.advice(), format!("ledgerctl acquire {PLACES}"));
    let place: Grant = fleet.get(&salma(), "acquire", &[PLACES]);
    assert_eq!((place.service.as_str(), place.limits), (PLACES, Limits::default()));
    assert_eq!(reads(&fleet, &salma()), Ok(()));
    assert!(told(&fleet, &salma()).allowed);

    let held = fleet.refused(&farhad(), Code::Held, "acquire", &[PLACES]);
    assert!(held.found.contains("Org1/Salma"), "{held}");
    assert_eq!(reads(&fleet, &farhad()), Err(Code::NotHolder));
    fleet.may_follow(&farhad(), &[TURTLEBOT], &["granted"]).unwrap();
    let robot: RobotAsset = fleet.get(&owner(), "robot", &["Turtlebot4"]);
    assert_eq!(robot.services[0].readers, ["Org1/Salma"]);
    assert!(robot.services[0].holders.is_empty() && !robot.under_operation, "nobody drives it");
}

#[test]
fn a_place_is_held_as_long_as_its_lease_lasts_or_until_it_is_given_back() {
    let mut fleet = one();
    fleet.ok(&salma(), "acquire", &[PLACES, "1000"]);
    fleet.ok(&salma(), "renew", &[PLACES]);
    fleet.time += SECOND;
    fleet.tick();
    assert_eq!(reads(&fleet, &salma()), Err(Code::NotHolder));
    fleet.ok(&farhad(), "acquire", &[PLACES]);
    fleet.ok(&farhad(), "release", &[PLACES]);
    assert_eq!(reads(&fleet, &farhad()), Err(Code::NotHolder));
    fleet.ok(&salma(), "acquire", &[PLACES]);
    fleet.revoke(&salma());
    assert_eq!(fleet.keys("grant/"), 0);
}

#[test]
fn a_subscriber_waits_in_a_line_of_its_own() {
    let mut fleet = one_with_line();
    fleet.ok(&salma(), "acquire", &[PLACES]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let waits: Acquired = fleet.get(&farhad(), "acquire", &[PLACES]);
    assert!(matches!(waits, Acquired::Queued { queued } if queued.position == 1 && queued.service == PLACES));
    let driven: LineState =
        serde_json::from_slice(&fleet.simulate(&owner(), "line", &[TURTLEBOT.into()]).unwrap()).unwrap();
    assert!(driven.line.is_empty(), "nobody waits to drive");
    fleet.ok(&salma(), "release", &[PLACES]);
    fleet.tick();
    let granted: Grant = fleet.newest("granted");
    assert_eq!((granted.service.as_str(), granted.holder.as_str()), (PLACES, "Org1/Farhad"));
    assert_eq!((reads(&fleet, &salma()), reads(&fleet, &farhad())), (Err(Code::NotHolder), Ok(())));
    fleet.set(&salma(), TURTLEBOT, 1, 1, 1).unwrap();
}

#[test]
fn without_a_limit_for_publishers_everybody_may_publish() {
    let mut fleet = one();
    fleet.set(&salma(), TURTLEBOT, 0, 1, 1).unwrap();
    fleet.set(&farhad(), TURTLEBOT, 0, 1, 1).unwrap();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"publishers":1}}"#]);
    fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 0, 2);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.refused(&farhad(), Code::Held, "acquire", &[TURTLEBOT]);
}

#[test]
fn the_owners_machines_read_without_a_place_and_others_need_the_right_to_subscribe() {
    let mut fleet = one();
    fleet.ok(&salma(), "acquire", &[PLACES]);
    assert_eq!(camera().organisation, owner().organisation);
    assert_eq!(reads(&fleet, &camera()), Ok(()));
    let stranger = identity("Org1", "Stranger", Role::Member, &[], 62);
    fleet.refused(&stranger, Code::MissingAttribute, "acquire", &[PLACES]);
    assert_eq!(reads(&fleet, &stranger), Err(Code::MissingAttribute));
    let forbids = r#"forbid (principal == User::"Org1/Salma", action == Action::"subscribe", resource);"#;
    fleet.ok(&owner(), "policy", &["put", "blind", forbids]);
    fleet.tick();
    assert_eq!(fleet.keys("grant/"), 0, "whom policies no longer let read loses the place");
}

#[test]
fn places_end_with_the_limit_and_with_the_robot_and_a_smaller_limit_keeps_the_oldest() {
    let mut fleet = fleet(r#"{"mode":"limited","sharing":{"subscribers":2}}"#);
    for who in [salma(), farhad()] {
        fleet.ok(&who, "acquire", &[PLACES]);
    }
    fleet.refused(&third(), Code::Held, "acquire", &[PLACES]);
    let change: RobotChange = fleet.get(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"subscribers":1}}"#]);
    let ended: Vec<_> = change.ended.iter().map(|one| (one.holder.as_str(), one.reason.known())).collect();
    assert_eq!(ended, [("Org1/Farhad", Some(Reason::Taken))]);
    let change: RobotChange =
        fleet.get(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"open","clear":["subscribers"]}"#]);
    assert_eq!(change.ended.len(), 1);
    assert_eq!(reads(&fleet, &farhad()), Ok(()));
    let gone = fleet.refused(&salma(), Code::UnknownService, "acquire", &[PLACES]);
    assert_eq!(gone.advice(), format!("subscribe without a slot: ledgerctl echo {TURTLEBOT}"));

    fleet.ok(
        &owner(),
        "configure",
        &[TURTLEBOT, r#"{"mode":"limited","sharing":{"subscribers":1,"on_conflict":"queue"}}"#],
    );
    fleet.ok(&salma(), "acquire", &[PLACES]);
    fleet.ok(&farhad(), "acquire", &[PLACES]);
    let ended: Vec<Released> = fleet.get(&owner(), "remove", &["Turtlebot4"]);
    assert_eq!(ended[0].service, PLACES);
    fleet.tick();
    let left: Left = fleet.newest("left");
    assert_eq!((left.contender.as_str(), left.reason.known()), ("Org1/Farhad", Some(LeftReason::RobotRemoved)));
    assert_eq!((fleet.keys("grant/"), fleet.keys("line/")), (0, 0));
}

#[test]
fn a_stop_of_the_robot_ends_no_place_and_a_reader_of_a_stopped_robot_gets_one() {
    let mut fleet = one();
    fleet.ok(&salma(), "acquire", &[PLACES]);
    fleet.ok(&owner(), "stop", &["Turtlebot4"]);
    assert_eq!(reads(&fleet, &salma()), Ok(()));
    fleet.ok(&salma(), "release", &[PLACES]);
    fleet.ok(&farhad(), "acquire", &[PLACES]);
}

#[test]
fn from_the_places_of_subscribers_nobody_publishes_and_takes_no_task() {
    let mut fleet = one();
    let place: Grant = fleet.get(&salma(), "acquire", &[PLACES]);
    let refused = fleet.set_refused(&salma(), Code::UnknownService, PLACES, place.epoch, 1);
    assert_eq!(refused.advice(), format!("publish on {TURTLEBOT}"));
    fleet.refused(&salma(), Code::BadArgument, "submit", &[PLACES, r#"{"points":[{"x_um":0,"y_um":0}]}"#]);
    let refused =
        fleet.refused(&owner(), Code::BadArgument, "configure", &[PLACES, r#"{"sharing":{"subscribers":9}}"#]);
    assert!(refused.advice().contains(TURTLEBOT), "{refused}");
    fleet.refused(&salma(), Code::UnknownService, "acquire", &[&format!("{HUSKY}:subscribe")]);
    fleet.refused(&salma(), Code::UnknownService, "acquire", &["Turtlebot4/nothing:subscribe"]);
}

#[test]
fn a_number_of_subscribers_that_is_none_is_refused() {
    let mut fleet = Fleet::of_the_paper();
    for number in ["0", "257", "18446744073709551615"] {
        let settings = format!(r#"{{"mode":"limited","sharing":{{"subscribers":{number}}}}}"#);
        let refused = fleet.refused(&owner(), Code::BadArgument, "configure", &[TURTLEBOT, &settings]);
        assert_eq!(refused.wanted, "1 to 256", "{refused}");
    }
    let refused =
        fleet.refused(&owner(), Code::BadArgument, "configure", &[TURTLEBOT, r#"{"sharing":{"subscribers":1}}"#]);
    assert!(refused.message.contains("mode=exclusive and subscribers"), "{refused}");
    let refused = fleet.refused(&owner(), Code::BadArgument, "configure", &[TURTLEBOT, r#"{"mode":"limited"}"#]);
    assert!(refused.message.contains("publishers or subscribers"), "{refused}");
}
