//! Leases, epochs and how they end.

use crate::fleet::{Fleet, HUSKY, SECOND, START, TURTLEBOT, admin1, farhad, identity, owner, robot, salma};
use ledger_abac::{Grant, Reason, Released, ServiceState};
use ledger_base::rejection::Code;
use ledger_identity::Role;

#[test]
fn a_held_service_says_who_holds_it_until_when() {
    let mut fleet = Fleet::of_the_paper();
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    let refusal = fleet.refused(&farhad(), Code::Held, "acquire", &[TURTLEBOT]);
    assert_eq!(
        refusal.message,
        format!("{TURTLEBOT} is held by Org1/Salma until {}", ledger_base::moment::rfc3339(grant.expires))
    );
    assert!(refusal.advice().contains("an admin of Org2"), "{refusal}");
    assert_eq!(refusal.code.class().exit_code(), 5);
}

#[test]
fn a_missing_attribute_is_named_beside_those_that_are_there() {
    let mut fleet = Fleet::of_the_paper();
    let refusal = fleet.refused(&farhad(), Code::MissingAttribute, "acquire", &[HUSKY]);
    assert_eq!(
        refusal.message,
        "Org1/Farhad may not acquire Husky/cmd_vel: the certificate lacks the attribute Husky=true"
    );
    assert_eq!(refusal.found, "attributes Turtlebot4=true");
    assert_eq!(refusal.advice(), "ask an admin of Org1 for the attribute, then enrol again");
    assert_eq!(refusal.code.class().exit_code(), 2);
    assert_eq!(fleet.refused(&admin1(), Code::MissingAttribute, "acquire", &[HUSKY]).found, "no attributes");
}

#[test]
fn only_the_exact_value_of_an_attribute_counts() {
    let mut fleet = Fleet::of_the_paper();
    let mut almost = salma();
    almost.fingerprint = [9; 32];
    almost.attributes.insert("Husky".into(), "TRUE".into());
    fleet.refused(&almost, Code::MissingAttribute, "acquire", &[HUSKY]);
    let named = robot("Husky", "exclusive").replace("\"Husky\",\n", "\"level=3\",\n");
    fleet.ok(&owner(), "replace", &[&named]);
    fleet.refused(&salma(), Code::MissingAttribute, "acquire", &[HUSKY]);
    almost.fingerprint = [10; 32];
    almost.attributes.insert("level".into(), "3".into());
    fleet.ok(&almost, "acquire", &[HUSKY]);
}

#[test]
fn epochs_grow_with_every_grant_and_survive_release_update_and_removal() {
    let mut fleet = Fleet::of_the_paper();
    let mut epochs = vec![];
    for round in 0..6 {
        epochs.push(fleet.get::<Grant>(&salma(), "acquire", &[TURTLEBOT]).epoch);
        match round {
            0 | 1 => fleet.ok(&salma(), "release", &[TURTLEBOT]),
            2 => {
                fleet.ok(&owner(), "replace", &[&robot("Turtlebot4", "exclusive")]);
                fleet.ok(&salma(), "release", &[TURTLEBOT]);
            }
            3 => {
                fleet.ok(&owner(), "remove", &["Turtlebot4"]);
                assert_eq!(fleet.newest::<Released>("released").reason, Reason::RobotRemoved);
                fleet.refused(&salma(), Code::UnknownRobot, "acquire", &[TURTLEBOT]);
                fleet.ok(&owner(), "setup", &[&robot("Turtlebot4", "exclusive")]);
            }
            _ => fleet.time += 11 * SECOND,
        }
    }
    assert_eq!(epochs, [1, 2, 3, 4, 5, 6]);
}

#[test]
fn acquiring_again_renews_the_same_epoch() {
    let mut fleet = Fleet::of_the_paper();
    let first: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, 1, 41, 1).unwrap();
    fleet.time += 5 * SECOND;
    let second: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT, "30000"]);
    assert_eq!((second.epoch, second.acquired_at, second.next_seq), (1, first.acquired_at, 42));
    assert_eq!(second.expires, fleet.time + 30 * SECOND);
    assert_eq!(fleet.newest::<Grant>("renewed"), second);
}

#[test]
fn a_lease_is_at_most_what_the_service_allows_and_never_outlives_the_certificate() {
    let mut fleet = Fleet::of_the_paper();
    let refusal = fleet.refused(&salma(), Code::BadArgument, "acquire", &[TURTLEBOT, "600001"]);
    assert_eq!((refusal.found.as_str(), refusal.wanted.contains("600000 ms")), ("600001 ms", true));
    fleet.refused(&salma(), Code::BadArgument, "acquire", &[TURTLEBOT, "99"]);
    let mut brief = salma();
    brief.not_after = START + 2 * SECOND;
    assert_eq!(fleet.get::<Grant>(&brief, "acquire", &[TURTLEBOT]).expires, brief.not_after);
}

#[test]
fn a_lease_that_runs_out_ends_at_the_start_of_the_block_that_reaches_it() {
    let mut fleet = Fleet::of_the_paper();
    assert_eq!(fleet.next_deadline(), None);
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[HUSKY, "20000"]);
    assert_eq!(fleet.next_deadline(), Some(grant.expires));

    fleet.time = grant.expires - 1001;
    let since = fleet.events.len();
    fleet.tick();
    assert_eq!(fleet.told(since), []);
    fleet.tick();
    assert_eq!(fleet.told(since), [("released", TURTLEBOT)]);
    assert_eq!(fleet.newest::<Released>("released").reason, Reason::Expired);
    assert!(fleet.next_deadline().unwrap() > grant.expires);
    let refusal = fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 1, 1);
    assert_eq!(refusal.found, "no holder");
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
}

#[test]
fn renew_extends_a_held_lease_and_only_that() {
    let mut fleet = Fleet::of_the_paper();
    fleet.refused(&salma(), Code::NotHolder, "renew", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.time += 9 * SECOND;
    let renewed: Grant = fleet.get(&salma(), "renew", &[TURTLEBOT]);
    assert_eq!((renewed.epoch, renewed.expires), (1, fleet.time + 10 * SECOND));
    assert_eq!(fleet.newest::<Grant>("renewed"), renewed);
    let refusal = fleet.refused(&farhad(), Code::NotHolder, "renew", &[TURTLEBOT]);
    assert!(refusal.found.starts_with("held by Org1/Salma until 2026-11-21T"), "{refusal}");
}

#[test]
fn use_renews_a_lease_but_writes_only_after_a_quarter_of_it() {
    let mut fleet = Fleet::of_the_paper();
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    fleet.set(&salma(), TURTLEBOT, 1, 1, 1).unwrap();
    assert_eq!(fleet.next_deadline(), Some(grant.expires));
    assert_eq!(fleet.writes.last().unwrap().len(), 1, "only the last message is written");
    fleet.time = grant.acquired_at + 2_499_000;
    fleet.set(&salma(), TURTLEBOT, 1, 2, 1).unwrap();
    assert_eq!(fleet.next_deadline(), Some(grant.expires));
    fleet.set(&salma(), TURTLEBOT, 1, 3, 1).unwrap();
    assert_eq!(fleet.next_deadline(), Some(fleet.time + 10 * SECOND));
    assert!(!fleet.events.iter().any(|event| event.name == "renewed"));
    // Used often enough, it lasts.
    for seq in 4..40 {
        fleet.time += 5 * SECOND;
        fleet.set(&salma(), TURTLEBOT, 1, seq, 1).unwrap();
    }
}

#[test]
fn only_the_holder_releases_and_the_owners_admin_takes_back() {
    let mut fleet = Fleet::of_the_paper();
    fleet.refused(&salma(), Code::NotHolder, "release", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.refused(&farhad(), Code::NotHolder, "release", &[TURTLEBOT]);
    fleet.refused(&admin1(), Code::NotHolder, "release", &[TURTLEBOT]);
    fleet.refused(&farhad(), Code::NotOwner, "release", &[TURTLEBOT, "Org1/Salma"]);
    fleet.refused(&owner(), Code::NotHolder, "release", &[TURTLEBOT, "Org1/Farhad"]);
    let member = identity("Org2", "Maria", Role::Member, &[], 40);
    fleet.refused(&member, Code::NotHolder, "release", &[TURTLEBOT]);
    fleet.refused(&member, Code::NotAdmin, "release", &[TURTLEBOT, "Org1/Salma"]);
    let taken: Vec<Released> = fleet.get(&owner(), "release", &[TURTLEBOT]);
    assert_eq!((taken.len(), taken[0].reason.known(), taken[0].epoch), (1, Some(Reason::Taken), 1));
    assert_eq!(fleet.newest::<Released>("released"), taken[0]);
    fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 1, 1);
    assert_eq!(fleet.get::<Vec<Released>>(&owner(), "release", &[TURTLEBOT]), []);
}

#[test]
fn revocation_ends_the_grants_of_that_certificate_in_its_block() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let mut other = farhad();
    other.issuer = [0; 32];
    other.serial = salma().serial;
    fleet.revoke(&other);
    assert_eq!(fleet.get::<Vec<Grant>>(&salma(), "grants", &[]).len(), 2);

    let since = fleet.events.len();
    fleet.revoke(&salma());
    assert_eq!(fleet.told(since), [("released", HUSKY), ("released", TURTLEBOT)]);
    assert_eq!(fleet.newest::<Released>("released").reason, Reason::Revoked);
    assert_eq!(fleet.get::<Vec<Grant>>(&farhad(), "grants", &[]), []);
    assert_eq!(fleet.next_deadline(), None);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
}

#[test]
fn the_grants_of_all_whom_an_authority_has_certified_end_in_the_block_in_which_it_is_lost() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    let mut other = salma();
    other.issuer = [0; 32];
    fleet.lose_authority(&other);
    assert_eq!(fleet.get::<Vec<Grant>>(&salma(), "grants", &[]).len(), 2);
    let since = fleet.events.len();
    fleet.lose_authority(&salma());
    let mut told = fleet.told(since);
    told.sort_unstable();
    assert_eq!(told, [("released", HUSKY), ("released", TURTLEBOT)]);
    assert_eq!(fleet.newest::<Released>("released").reason, Reason::Revoked);
    assert_eq!(fleet.next_deadline(), None);
}

#[test]
fn the_grants_of_an_organisation_end_in_the_block_that_removes_it() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "acquire", &[HUSKY]);
    fleet.remove_organisation("Org9");
    assert_eq!(fleet.get::<Vec<Grant>>(&salma(), "grants", &[]).len(), 2);
    let since = fleet.events.len();
    fleet.remove_organisation("Org1");
    assert_eq!(fleet.told(since), [("released", HUSKY), ("released", TURTLEBOT)]);
    assert_eq!(fleet.newest::<Released>("released").reason, Reason::Revoked);
    assert_eq!(fleet.next_deadline(), None);
}

#[test]
fn the_robots_of_an_organisation_are_taken_out_of_service_in_the_block_that_removes_it() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.remove_organisation("Org2");
    assert_eq!(fleet.newest::<Released>("released").reason, Reason::RobotRemoved);
    fleet.set_refused(&salma(), Code::UnknownRobot, TURTLEBOT, 1, 1);
    assert_eq!(fleet.get::<Vec<serde_json::Value>>(&salma(), "robots", &[]).len(), 0);
}

#[test]
fn who_has_nothing_to_release_is_not_told_to_acquire() {
    let mut fleet = Fleet::of_the_paper();
    let refusal = fleet.refused(&salma(), Code::NotHolder, "release", &[TURTLEBOT]);
    assert!(refusal.advice().starts_with("there is nothing to release"), "{refusal}");
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    let refusal = fleet.refused(&salma(), Code::NotHolder, "release", &[TURTLEBOT]);
    assert_eq!(refusal.advice(), "only the holder, or an admin of Org2, can release it");
    let refusal = fleet.refused(&owner(), Code::NotHolder, "release", &[TURTLEBOT, "Org1/Salma"]);
    assert!(
        refusal.found.starts_with("held by Org1/Farhad") && refusal.wanted == "a holder of the service",
        "{refusal}"
    );
    let refusal = fleet.refused(&salma(), Code::NotHolder, "renew", &[TURTLEBOT]);
    assert_eq!(refusal.advice(), "once it is free: ledgerctl acquire Turtlebot4/cmd_vel");
}

#[test]
fn a_new_certificate_of_the_same_person_fences_off_the_old_one() {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let renewed = identity("Org1", "Salma", Role::Member, &["Turtlebot4"], 100);
    let refusal = fleet.set_refused(&renewed, Code::NotHolder, TURTLEBOT, 1, 1);
    assert!(refusal.found.starts_with("acquired with another certificate, until 20"), "{refusal}");
    assert_eq!(fleet.get::<Grant>(&renewed, "acquire", &[TURTLEBOT]).epoch, 2);
    fleet.set_refused(&salma(), Code::StaleEpoch, TURTLEBOT, 1, 1);
    fleet.set_refused(&salma(), Code::NotHolder, TURTLEBOT, 2, 1);
    fleet.set(&renewed, TURTLEBOT, 2, 1, 1).unwrap();
    fleet.revoke(&salma());
    fleet.set(&renewed, TURTLEBOT, 2, 2, 1).unwrap();
    fleet.revoke(&renewed);
    fleet.set_refused(&renewed, Code::NotHolder, TURTLEBOT, 2, 3);
}

#[test]
fn a_service_tells_its_state() {
    let mut fleet = Fleet::of_the_paper();
    let free: ServiceState = fleet.get(&farhad(), "service", &["Turtlebot4"]);
    assert_eq!((free.service.as_str(), free.holder.as_str(), free.epoch, free.expires), (TURTLEBOT, "", 0, 0));
    let grant: Grant = fleet.get(&salma(), "acquire", &[TURTLEBOT]);
    let held: ServiceState = fleet.get(&farhad(), "service", &[TURTLEBOT]);
    assert_eq!((held.holder.as_str(), held.epoch, held.expires), ("Org1/Salma", 1, grant.expires));
    assert_eq!(held.type_name, "geometry_msgs/msg/Twist");
    assert_eq!(fleet.get::<Vec<Grant>>(&farhad(), "grants", &[TURTLEBOT]), [grant]);
}
