//! Passing a grant on, for a while or for good, and taking it back.

use crate::fleet::{Fleet, SECOND, TURTLEBOT, farhad, identity, owner, salma};
use ledger_abac::{Delegated, Grant, LineState, Reason, Released};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

fn third() -> Identity {
    identity("Org1", "Third", Role::Member, &["Turtlebot4"], 61)
}

/// Salma holds a service that can be passed on.
fn fleet(sharing: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    fleet.members.1.lock().unwrap().push(third());
    fleet.ok(&owner(), "configure", &[TURTLEBOT, &format!(r#"{{"sharing":{{"delegable":true{sharing}}}}}"#)]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet
}

fn holders(fleet: &Fleet) -> Vec<String> {
    let state = fleet.simulate(&owner(), "line", &[TURTLEBOT.into()]).unwrap();
    let state: LineState = serde_json::from_slice(&state).unwrap();
    state.holders.into_iter().map(|grant| grant.holder).collect()
}

#[test]
fn a_delegated_grant_has_a_new_epoch_follows_without_a_stop_and_is_taken_back() {
    let mut fleet = fleet("");
    let since = fleet.events.len();
    let grant: Grant = fleet.get(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    assert_eq!((grant.holder.as_str(), grant.epoch, grant.follows), ("Org1/Farhad", 2, Some(1)));
    assert_eq!(grant.givers, ["Org1/Salma"]);
    let names: Vec<&str> = fleet.told(since).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["released", "granted", "delegated"], "in one block");
    let released: Released = fleet.newest("released");
    assert_eq!(
        (released.reason.known(), released.by.as_deref(), released.goes_on),
        (Some(Reason::Delegated), Some("Org1/Farhad"), true)
    );
    let told: Delegated = fleet.newest("delegated");
    assert_eq!((told.giver.as_str(), told.epoch, told.for_good), ("Org1/Salma", 2, false));
    fleet.set_refused(&salma(), Code::StaleEpoch, TURTLEBOT, 1, 1);
    fleet.set(&farhad(), TURTLEBOT, 2, 1, 1).unwrap();
    let refused = fleet.refused(&salma(), Code::NotHolder, "renew", &[TURTLEBOT]);
    assert_eq!(refused.advice(), format!("recall it: ledgerctl recall {TURTLEBOT}"));

    let back: Grant = fleet.get(&salma(), "recall", &[TURTLEBOT]);
    assert_eq!((back.holder.as_str(), back.epoch, back.follows), ("Org1/Salma", 3, Some(2)));
    assert!(back.givers.is_empty());
    fleet.set_refused(&farhad(), Code::StaleEpoch, TURTLEBOT, 2, 2);
    fleet.refused(&salma(), Code::NotHolder, "recall", &[TURTLEBOT]);
}

#[test]
fn a_stop_between_both_comes_only_if_it_is_asked_for() {
    let mut fleet = fleet("");
    let grant: Grant = fleet.get(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad", r#"{"stop":true}"#]);
    assert_eq!((grant.follows, fleet.newest::<Released>("released").goes_on), (None, false));
    let grant: Grant = fleet.get(&salma(), "recall", &[TURTLEBOT, r#"{"stop":true}"#]);
    assert_eq!((grant.follows, fleet.newest::<Released>("released").goes_on), (None, false));
}

#[test]
fn who_is_handed_a_robot_over_has_it_for_good() {
    let mut fleet = fleet("");
    let grant: Grant = fleet.get(&salma(), "handover", &[TURTLEBOT, "Org1/Farhad"]);
    assert!(grant.givers.is_empty() && grant.follows == Some(1));
    assert!(fleet.newest::<Delegated>("delegated").for_good);
    fleet.refused(&salma(), Code::NotHolder, "recall", &[TURTLEBOT]);
    // It is a grant like any other, which can be passed on again.
    fleet.ok(&farhad(), "delegate", &[TURTLEBOT, "Org1/Salma"]);
}

#[test]
fn a_delegation_ends_when_its_giver_said_however_it_is_renewed() {
    let mut fleet = fleet("");
    let options = r#"{"for_ms":30000}"#;
    let grant: Grant = fleet.get(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad", options]);
    let ends = fleet.newest::<Delegated>("delegated").ends_by.unwrap();
    assert_eq!((grant.expires, ends), (fleet.time + 10 * SECOND, fleet.time + 30 * SECOND));
    for seq in 1..=5 {
        fleet.time += 5 * SECOND;
        fleet.set(&farhad(), TURTLEBOT, 2, seq, 1).unwrap();
    }
    assert_eq!(fleet.get::<Grant>(&farhad(), "renew", &[TURTLEBOT]).expires, ends);
    fleet.time = ends;
    fleet.tick();
    assert!(holders(&fleet).is_empty());
}

#[test]
fn a_chain_is_as_long_as_its_givers_allow_and_never_comes_back() {
    let mut fleet = fleet("");
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    let refused = fleet.refused(&farhad(), Code::NotDelegable, "delegate", &[TURTLEBOT, "Org1/Third"]);
    assert_eq!(refused.found, "delegated by Org1/Salma");
    fleet.ok(&salma(), "recall", &[TURTLEBOT]);
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad", r#"{"may_delegate":true}"#]);
    let refused = fleet.refused(&farhad(), Code::BadArgument, "delegate", &[TURTLEBOT, "Org1/Salma"]);
    assert!(refused.message.contains("the receiver delegated it before"), "{refused}");
    let refused = fleet.refused(&farhad(), Code::BadArgument, "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    assert!(refused.message.contains("the receiver is the holder"), "{refused}");
    let grant: Grant = fleet.get(&farhad(), "delegate", &[TURTLEBOT, "Org1/Third"]);
    assert_eq!(grant.givers, ["Org1/Salma", "Org1/Farhad"]);
    // Everybody in the chain may take it back; those after it are out.
    let back: Grant = fleet.get(&farhad(), "recall", &[TURTLEBOT]);
    assert_eq!((back.givers.as_slice(), back.may_delegate), (&["Org1/Salma".to_owned()][..], true));
    fleet.ok(&farhad(), "delegate", &[TURTLEBOT, "Org1/Third"]);
    assert!(fleet.get::<Grant>(&salma(), "recall", &[TURTLEBOT]).givers.is_empty());
    fleet.refused(&farhad(), Code::NotHolder, "recall", &[TURTLEBOT]);
}

#[test]
fn a_chain_ends_with_any_of_its_links() {
    let forbid =
        r#"permit (principal, action, resource); forbid (principal == User::"Org1/Farhad", action, resource);"#;
    for end in ["salma", "farhad", "third", "policy"] {
        let mut fleet = fleet("");
        fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad", r#"{"may_delegate":true}"#]);
        fleet.ok(&farhad(), "delegate", &[TURTLEBOT, "Org1/Third"]);
        match end {
            "salma" => fleet.revoke(&salma()),
            "farhad" => fleet.revoke(&farhad()),
            "third" => fleet.revoke(&third()),
            _ => fleet.ok(&owner(), "policy", &["put", "p", forbid]),
        }
        assert!(holders(&fleet).is_empty(), "{end}");
        let leftovers = fleet.keys("certificate/");
        assert_eq!(leftovers, 0, "{end}");
    }
    let mut fleet = fleet("");
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    fleet.remove_organisation("Org1");
    assert!(holders(&fleet).is_empty());
}

#[test]
fn only_whom_policies_permit_receives_and_only_the_holder_gives() {
    let mut fleet = fleet("");
    fleet.refused(&salma(), Code::MissingAttribute, "delegate", &[TURTLEBOT, "Org1/admin"]);
    fleet.refused(&salma(), Code::NotFound, "delegate", &[TURTLEBOT, "Org1/Nobody"]);
    fleet.refused(&salma(), Code::NotFound, "handover", &[TURTLEBOT, "Farhad"]);
    fleet.refused(&farhad(), Code::NotHolder, "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    fleet.refused(&salma(), Code::BadArgument, "delegate", &[TURTLEBOT, "Org1/Farhad", r#"{"for_ms":0}"#]);
    fleet.refused(&salma(), Code::BadArgument, "delegate", &[TURTLEBOT, "Org1/Farhad", r#"{"for_ms":-1}"#]);
    fleet.refused(&salma(), Code::BadArgument, "handover", &[TURTLEBOT, "Org1/Farhad", r#"{"for_ms":1000}"#]);
    assert_eq!(holders(&fleet), ["Org1/Salma"]);
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"clear":["delegable"]}"#]);
    let refused = fleet.refused(&salma(), Code::NotDelegable, "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    assert!(refused.advice().contains("delegable=true"), "{refused}");
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"sharing":{"delegable":true}}"#]);
    fleet.ok(&owner(), "take", &[TURTLEBOT, "fire"]);
    fleet.refused(&owner(), Code::NotDelegable, "handover", &[TURTLEBOT, "Org1/Farhad"]);
}

/// Two who pass a robot to each other would else never be preempted.
#[test]
fn passing_a_robot_on_renews_no_min_hold() {
    let sharing = r#","on_conflict":"preempt","priority":"attribute:rank","min_hold_ms":10000"#;
    let mut fleet = fleet(sharing);
    let urgent = {
        let mut urgent = third();
        urgent.attributes.insert("rank".to_owned(), "1".to_owned());
        urgent
    };
    fleet.time += 9 * SECOND;
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    fleet.refused(&urgent, Code::Held, "acquire", &[TURTLEBOT]);
    fleet.time += SECOND;
    fleet.ok(&urgent, "acquire", &[TURTLEBOT]);
}

/// One with two certificates would else never be preempted.
#[test]
fn another_certificate_of_the_holder_renews_no_min_hold() {
    let sharing = r#","on_conflict":"preempt","priority":"attribute:rank","min_hold_ms":10000"#;
    let mut fleet = fleet(sharing);
    let mut urgent = third();
    urgent.attributes.insert("rank".to_owned(), "1".to_owned());
    let mut other = salma();
    other.serial = vec![99];
    other.fingerprint[0] ^= 1;
    fleet.time += 9 * SECOND;
    fleet.ok(&other, "acquire", &[TURTLEBOT]);
    fleet.refused(&urgent, Code::Held, "acquire", &[TURTLEBOT]);
    fleet.time += SECOND;
    fleet.ok(&urgent, "acquire", &[TURTLEBOT]);
}

#[test]
fn another_certificate_of_the_receiver_keeps_what_its_giver_said() {
    let mut fleet = fleet("");
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad", r#"{"for_ms":20000}"#]);
    let ends = fleet.newest::<Delegated>("delegated").ends_by.unwrap();
    let mut renewed = farhad();
    renewed.serial = vec![99];
    renewed.fingerprint[0] ^= 1;
    let grant: Grant = fleet.get(&renewed, "acquire", &[TURTLEBOT, "60000"]);
    assert_eq!((grant.epoch, grant.expires, grant.givers.len()), (3, ends, 1));
    fleet.ok(&salma(), "recall", &[TURTLEBOT]);
}

#[test]
fn a_receiver_that_waited_in_line_waits_no_longer() {
    let mut fleet = fleet(r#","on_conflict":"queue""#);
    fleet.ok(&third(), "acquire", &[TURTLEBOT]);
    fleet.ok(&farhad(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "handover", &[TURTLEBOT, "Org1/Farhad"]);
    fleet.tick();
    assert_eq!(holders(&fleet), ["Org1/Farhad"], "who stood before it in line keeps its place");
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    fleet.tick();
    assert_eq!(holders(&fleet), ["Org1/Third"]);
}

#[test]
fn a_giver_that_has_a_grant_of_its_own_again_takes_no_second_one_back() {
    let mut fleet = fleet("");
    fleet.ok(&owner(), "configure", &[TURTLEBOT, r#"{"mode":"limited","sharing":{"publishers":2}}"#]);
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    let refused = fleet.refused(&salma(), Code::BadArgument, "recall", &[TURTLEBOT]);
    assert!(refused.message.contains("has a grant already"), "{refused}");
    assert_eq!(holders(&fleet), ["Org1/Farhad", "Org1/Salma"]);
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    fleet.ok(&salma(), "recall", &[TURTLEBOT]);
    assert_eq!(holders(&fleet), ["Org1/Salma"]);
}

#[test]
fn a_giver_that_takes_a_robot_back_waits_for_it_no_longer() {
    let mut fleet = fleet(r#","on_conflict":"queue""#);
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT]);
    fleet.ok(&salma(), "recall", &[TURTLEBOT]);
    assert_eq!(fleet.keys("line/"), 0);
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    fleet.tick();
    assert!(holders(&fleet).is_empty());
}

#[test]
fn acquiring_what_was_delegated_renews_it_only_while_policies_permit_its_giver() {
    let mut fleet = fleet("");
    let closes = fleet.time / 1000 + 5000;
    let until = format!(
        r#"permit (principal == User::"Org1/Farhad", action, resource);
        permit (principal, action, resource) when {{ context.time < {closes} }};"#
    );
    fleet.ok(&owner(), "policy", &["put", "p", &until]);
    fleet.ok(&salma(), "delegate", &[TURTLEBOT, "Org1/Farhad"]);
    fleet.time += 6 * SECOND;
    fleet.refused(&farhad(), Code::DeniedByPolicy, "renew", &[TURTLEBOT]);
    fleet.refused(&farhad(), Code::DeniedByPolicy, "acquire", &[TURTLEBOT]);
    fleet.time += 10 * SECOND;
    fleet.tick();
    assert!(holders(&fleet).is_empty());
}
