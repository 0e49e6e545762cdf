//! Confirmation: who must agree before a contender competes.

use crate::fleet::{Fleet, SECOND, TURTLEBOT, farhad, identity, owner, salma};
use ledger_abac::{Acquired, Confirmation, Grant, Left, LeftReason, LineState, Pending};
use ledger_base::rejection::Code;
use ledger_identity::{Identity, Role};

/// A safety officer, as the default policy knows them.
fn officer(name: &str, serial: u8) -> Identity {
    identity("Org1", name, Role::Member, &["safety"], serial)
}

fn fleet(sharing: &str) -> Fleet {
    let mut fleet = Fleet::of_the_paper();
    fleet.ok(&owner(), "configure", &[TURTLEBOT, &format!(r#"{{"sharing":{{"confirm":2{sharing}}}}}"#)]);
    fleet
}

fn asks(fleet: &mut Fleet, who: &Identity) -> Pending {
    match fleet.get(who, "acquire", &[TURTLEBOT]) {
        Acquired::Pending { pending } => pending,
        other => panic!("{other:?}"),
    }
}

fn confirm(fleet: &mut Fleet, who: &Identity) -> Confirmation {
    fleet.get(who, "confirm", &[TURTLEBOT, "Org1/Salma"])
}

fn state(fleet: &Fleet) -> LineState {
    let state = fleet.simulate(&owner(), "line", &[TURTLEBOT.into()]).unwrap();
    serde_json::from_slice(&state).unwrap()
}

#[test]
fn a_contender_competes_when_the_last_one_has_confirmed_it() {
    let mut fleet = fleet("");
    let pending = asks(&mut fleet, &salma());
    assert_eq!((pending.wanted, pending.owner.as_str(), pending.until), (2, "Org2", fleet.time + 60 * SECOND));
    assert_eq!(state(&fleet).pending, [pending]);
    let first = confirm(&mut fleet, &owner());
    assert_eq!((first.pending.confirmed.as_slice(), first.acquired), (&["Org2/admin".to_owned()][..], None));
    assert_eq!(confirm(&mut fleet, &owner()).acquired, None, "nobody counts twice");
    let last = confirm(&mut fleet, &officer("Safe", 51));
    assert!(matches!(&last.acquired, Some(Acquired::Granted(grant)) if grant.holder == "Org1/Salma"), "{last:?}");
    fleet.set(&salma(), TURTLEBOT, 1, 1, 1).unwrap();
    assert!(state(&fleet).pending.is_empty());
    let leftovers = fleet.keys("asking/");
    assert_eq!(leftovers, 0);
    assert_eq!(fleet.get::<Grant>(&salma(), "acquire", &[TURTLEBOT]).epoch, 1, "a renewal needs nobody");
}

#[test]
fn nobody_confirms_itself_and_nobody_whom_policies_do_not_permit() {
    let mut fleet = fleet("");
    asks(&mut fleet, &salma());
    let refused = fleet.refused(&salma(), Code::BadArgument, "confirm", &[TURTLEBOT, "Org1/Salma"]);
    assert!(refused.message.contains("cannot confirm itself"), "{refused}");
    let refused = fleet.refused(&farhad(), Code::DeniedByPolicy, "confirm", &[TURTLEBOT, "Org1/Salma"]);
    assert!(refused.wanted.contains("an admin of Org2"), "{refused}");
    fleet.refused(&owner(), Code::NotFound, "confirm", &[TURTLEBOT, "Org1/Farhad"]);
    // An officer who wants the robot itself needs two others.
    let mut greedy = officer("Greedy", 52);
    greedy.attributes.insert("Turtlebot4".to_owned(), "true".to_owned());
    asks(&mut fleet, &greedy);
    fleet.refused(&greedy, Code::BadArgument, "confirm", &[TURTLEBOT, "Org1/Greedy"]);
    assert!(state(&fleet).holders.is_empty());
}

#[test]
fn confirmations_count_until_their_time_is_over() {
    let mut fleet = fleet(r#","confirm_within_ms":5000"#);
    asks(&mut fleet, &salma());
    confirm(&mut fleet, &owner());
    assert_eq!(fleet.next_deadline(), Some(fleet.newest::<Pending>("pending").until));
    fleet.time += 6 * SECOND;
    fleet.tick();
    assert_eq!(fleet.newest::<Left>("left").reason.known(), Some(LeftReason::Unconfirmed));
    fleet.refused(&officer("Safe", 51), Code::NotFound, "confirm", &[TURTLEBOT, "Org1/Salma"]);
    assert_eq!(fleet.next_deadline(), None);
}

#[test]
fn a_confirmed_contender_waits_in_line_or_tries_again() {
    // Without a line it hears that the service is held, and may try again while it is confirmed.
    let mut fleet = fleet("");
    asks(&mut fleet, &salma());
    asks(&mut fleet, &farhad());
    for who in [owner(), officer("Safe", 51)] {
        fleet.ok(&who, "confirm", &[TURTLEBOT, "Org1/Farhad"]);
    }
    confirm(&mut fleet, &owner());
    let last = confirm(&mut fleet, &officer("Safe", 51));
    assert!(last.acquired.is_none() && last.refused.contains("held by Org1/Farhad"), "{last:?}");
    fleet.refused(&salma(), Code::Held, "acquire", &[TURTLEBOT]);
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    assert_eq!(fleet.get::<Grant>(&salma(), "acquire", &[TURTLEBOT]).holder, "Org1/Salma");

    // So does one that does not want to stand in the line that there is.
    let mut fleet = self::fleet(r#","on_conflict":"queue""#);
    fleet.ok(&salma(), "acquire", &[TURTLEBOT, r#"{"wait_ms":0}"#]);
    asks(&mut fleet, &farhad());
    for officer in [owner(), officer("Safe", 51)] {
        fleet.ok(&officer, "confirm", &[TURTLEBOT, "Org1/Farhad"]);
    }
    confirm(&mut fleet, &owner());
    let last = confirm(&mut fleet, &officer("Safe", 51));
    assert!(last.acquired.is_none() && last.refused.contains("held by Org1/Farhad"), "{last:?}");
    assert_eq!((last.pending.confirmed.len(), state(&fleet).line.len()), (2, 0), "it counts");

    // So does one for whom the line has no room.
    let mut fleet = self::fleet(r#","on_conflict":"queue","queue_max":1"#);
    let third = identity("Org1", "Third", Role::Member, &["Turtlebot4"], 54);
    for contender in [farhad(), third, salma()] {
        asks(&mut fleet, &contender);
    }
    for contender in ["Org1/Farhad", "Org1/Third"] {
        for officer in [owner(), officer("Safe", 51)] {
            fleet.ok(&officer, "confirm", &[TURTLEBOT, contender]);
        }
    }
    assert_eq!((state(&fleet).holders.len(), state(&fleet).line.len()), (1, 1));
    confirm(&mut fleet, &owner());
    let last = confirm(&mut fleet, &officer("Safe", 51));
    assert!(last.acquired.is_none() && last.refused.contains("is full"), "{last:?}");
    assert_eq!(last.pending.confirmed.len(), 2, "it counts");

    // With one it takes its place, and needs nobody when its turn comes.
    let mut fleet = self::fleet(r#","on_conflict":"queue""#);
    for who in ["Org1/Farhad", "Org1/Salma"] {
        asks(&mut fleet, &if who == "Org1/Salma" { salma() } else { farhad() });
        for officer in [owner(), officer("Safe", 51)] {
            fleet.ok(&officer, "confirm", &[TURTLEBOT, who]);
        }
    }
    assert_eq!(state(&fleet).line.len(), 1);
    fleet.ok(&farhad(), "release", &[TURTLEBOT]);
    fleet.tick();
    assert_eq!(state(&fleet).holders[0].holder, "Org1/Salma");
}

#[test]
fn a_revoked_certificate_neither_asks_nor_confirms() {
    let mut fleet = fleet("");
    let safe = officer("Safe", 51);
    asks(&mut fleet, &salma());
    confirm(&mut fleet, &safe);
    fleet.revoke(&safe);
    assert!(confirm(&mut fleet, &owner()).acquired.is_none(), "one of two counts no more");
    fleet.revoke(&salma());
    assert_eq!(fleet.newest::<Left>("left").reason.known(), Some(LeftReason::Revoked));
    fleet.refused(&officer("Other", 53), Code::NotFound, "confirm", &[TURTLEBOT, "Org1/Salma"]);
}

#[test]
fn whom_policies_no_longer_permit_to_confirm_counts_no_more() {
    let mut fleet = fleet("");
    asks(&mut fleet, &salma());
    confirm(&mut fleet, &officer("Safe", 51));
    let text = r#"permit (principal, action, resource);
        permit (principal, action == Action::"confirm", resource); forbid (principal, action == Action::"confirm", resource)
        when { principal.name == "Safe" };"#;
    fleet.ok(&owner(), "policy", &["put", "p", text]);
    assert!(confirm(&mut fleet, &owner()).acquired.is_none(), "one of two counts no more");
    // Nor does it count when the contender asks again.
    asks(&mut fleet, &salma());
    assert!(confirm(&mut fleet, &officer("Other", 52)).acquired.is_some());
}

#[test]
fn who_asked_takes_it_back_and_a_removed_robot_forgets_it() {
    let mut fleet = fleet("");
    asks(&mut fleet, &salma());
    fleet.ok(&salma(), "release", &[TURTLEBOT]);
    assert_eq!(fleet.newest::<Left>("left").reason.known(), Some(LeftReason::Left));
    asks(&mut fleet, &salma());
    fleet.ok(&owner(), "remove", &["Turtlebot4"]);
    fleet.tick();
    let leftovers = fleet.keys("pending/");
    assert_eq!(leftovers, 0);
}

#[test]
fn confirm_goes_together_with_what_keeps_its_promise() {
    let mut fleet = Fleet::of_the_paper();
    for (sharing, message) in [
        (r#"{"confirm":2,"delegable":true}"#, "confirm and delegable of service /cmd_vel cannot be combined"),
        (r#"{"confirm_within_ms":1000}"#, "confirm_within_ms of service /cmd_vel needs confirm"),
        (r#"{"confirm":0}"#, "confirm of service /cmd_vel is out of range"),
        (r#"{"confirm":17}"#, "confirm of service /cmd_vel is out of range"),
    ] {
        let settings = format!(r#"{{"sharing":{sharing}}}"#);
        let refused = fleet.refused(&owner(), Code::BadArgument, "configure", &[TURTLEBOT, &settings]);
        assert_eq!(refused.message, message);
    }
    let open = r#"{"mode":"open","sharing":{"confirm":2}}"#;
    let refused = fleet.refused(&owner(), Code::BadArgument, "configure", &[TURTLEBOT, open]);
    assert_eq!(refused.message, "mode=open and confirm of service /cmd_vel cannot be combined");
}
