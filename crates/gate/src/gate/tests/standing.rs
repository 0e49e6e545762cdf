//! The newest answer of the voters decides, and for a while only.

use super::*;
use crate::standing::Standing;
use std::sync::Arc;

#[test]
fn a_new_grant_fences_off_the_holder_before() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Ok(1));
    let next = [grant("Org1/Farhad", 4)];
    assert_eq!(learn(&mut gate, &network, &service("exclusive"), &next), Some("released"), "she moved the robot");
    assert!(!gate.is_moving());
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 2, &TWIST)), Err(Refused::StaleEpoch));
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(4, 2, &TWIST)), Err(Refused::NotHolder));
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(4, 1, &TWIST)), Ok(1));
}

#[test]
fn a_standing_from_before_the_newest_one_does_not_bring_the_old_holder_back() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[]);
    let newer = network.standing(9, &[grant("Org1/Farhad", 4)]);
    assert_eq!(gate.learn(&service("exclusive"), &newer, now().steady, now()), None);
    let older = network.standing(8, &[grant("Org1/Salma", 3)]);
    assert_eq!(gate.learn(&service("exclusive"), &older, now().steady, now()), None);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Err(Refused::StaleEpoch));
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(4, 1, &TWIST)), Ok(1));
}

#[test]
fn a_node_that_makes_up_an_end_stops_the_robot_until_the_voters_say_otherwise() {
    let network = Network::default();
    let held = [grant("Org1/Salma", 3)];
    let mut gate = network.gate(&service("exclusive"), &held);
    let end_of_time = u64::MAX;
    assert!(gate.released(&released("Org1/Salma", end_of_time), end_of_time, now()), "anybody may stop a robot");
    assert!(!gate.revoked(&network.salma.revocation(&network), now()), "nobody moved it");
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Err(Refused::Revoked));
    assert_eq!(learn(&mut gate, &network, &service("exclusive"), &held), None);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Ok(1), "neither was true");
    assert_eq!(gate.fault(), None);
}

#[test]
fn the_answer_to_an_earlier_question_undoes_no_end_of_which_a_node_has_told_since() {
    let network = Network::default();
    let held = [grant("Org1/Salma", 3)];
    let before = now().steady - 1;
    let mut gate = network.gate(&service("exclusive"), &held);
    assert!(gate.released(&released("Org1/Salma", 3), NOW, now()));
    gate.learn(&service("exclusive"), &network.standing(2, &held), before, now());
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Err(Refused::NotHolder));
    let mut gate = network.gate(&service("exclusive"), &held);
    assert!(!gate.revoked(&network.salma.revocation(&network), now()));
    gate.learn(&service("exclusive"), &network.standing(2, &held), before, now());
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Err(Refused::Revoked));
    gate.learn(&service("exclusive"), &network.standing(2, &held), now().steady, now());
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Ok(1), "it was asked for since");
}

#[test]
fn a_command_passes_only_for_so_long_after_the_question_that_the_voters_answered() {
    let network = Network::default();
    let held = [grant("Org1/Salma", 3)];
    let mut gate = network.gate(&service("exclusive"), &held);
    assert_eq!(gate.fresh_until(), Some(now().steady + SECOND));
    let late = |gate: &mut Gate, after: u64, seq: u64| {
        let wall = NOW + after;
        let user = User { not_after: wall + 2 * SECOND, ..network.salma.clone() };
        let signed = user.set(3, seq, &TWIST);
        let delivered = Delivered { block_time: wall, transaction: signed.encoded(), certificate: &user.certificate };
        gate.pass(delivered, now_at(wall)).map(drop)
    };
    assert_eq!(late(&mut gate, SECOND, 1), Ok(()));
    assert_eq!(late(&mut gate, SECOND + 1, 2), Err(Refused::Stale), "who holds the robot may have changed");
    assert!(Refused::Stale.may_pass_later());
    gate.learn(&service("exclusive"), &network.standing(2, &held), now_at(NOW + SECOND).steady, now_at(NOW + SECOND));
    assert_eq!(late(&mut gate, 2 * SECOND, 2), Ok(()));
    // The same block again, as the answer to a later question.
    gate.learn(
        &service("exclusive"),
        &network.standing(2, &held),
        now_at(NOW + 2 * SECOND).steady,
        now_at(NOW + 2 * SECOND),
    );
    assert_eq!(gate.fresh_until(), Some(now_at(NOW + 3 * SECOND).steady));
}

#[test]
fn a_network_whose_time_is_ahead_of_the_robots_clock_drives_it() {
    let network = Network::default();
    let held = [Grant { expires: NOW + 604 * SECOND, ..grant("Org1/Salma", 3) }];
    let mut gate = network.gate(&service("exclusive"), &held);
    let ahead = NOW + 600 * SECOND;
    let user = User { not_after: ahead + 2 * SECOND, ..network.salma.clone() };
    let signed = user.set(3, 1, &TWIST);
    assert_eq!(deliver_at(&mut gate, &user, &signed, ahead), Err(Refused::FromFuture), "only its node says so");
    let standing = Standing { time: ahead, ..network.standing(2, &held) };
    gate.learn(&service("exclusive"), &standing, now().steady, now());
    assert_eq!(deliver_at(&mut gate, &user, &signed, ahead), Ok(1), "the voters have signed it");
    assert_eq!(gate.deadline(), Some(now().steady + 4 * SECOND));
    gate.stopped(now());
    let on_its_way = user.set(3, 2, &TWIST);
    let refused = deliver_at(&mut gate, &user, &on_its_way, ahead);
    assert_eq!(refused, Ok(1), "signed at the moment of the stop");
    let before = User { not_after: ahead + 2 * SECOND - 1, ..network.salma.clone() };
    let refused = deliver_at(&mut gate, &before, &before.set(3, 3, &TWIST), ahead);
    assert_eq!(refused, Err(Refused::BeforeStop), "the robot's own clock is ten minutes behind");
}

#[test]
fn a_gate_that_was_opened_in_a_network_whose_time_is_ahead_takes_nothing_from_before() {
    let network = Network::default();
    let mut gate = Gate::new(of_commands(&network), "T/cmd_vel", now());
    let (ahead, later) = (NOW + 600 * SECOND, now_at(NOW + SECOND / 2));
    let standing = Standing { time: ahead, ..network.standing(2, &[]) };
    gate.learn(&service("open"), &standing, later.steady, later);
    let opened = ahead - SECOND / 2;
    for (signed_at, passes) in [(opened - 1, Err(Refused::BeforeStop)), (opened, Ok(()))] {
        let user = User { not_after: signed_at + 2 * SECOND, ..network.salma.clone() };
        let signed = user.set(0, 1, &TWIST);
        let delivered = Delivered { block_time: ahead, transaction: signed.encoded(), certificate: &user.certificate };
        assert_eq!(gate.pass(delivered, later).map(drop), passes);
    }
}

#[test]
fn a_standing_without_the_driver_stops_the_robot() {
    let network = Network::default();
    let held = [grant("Org1/Salma", 3)];
    for (mode, grants, revoked, why) in [
        ("exclusive", &held[..], false, None),
        ("exclusive", &[], false, Some("released")),
        ("exclusive", &held, true, Some("revoked")),
        ("open", &[], false, None),
        ("open", &[], true, Some("revoked")),
        ("open by name", &[], true, Some("revoked")),
    ] {
        let (mode, by_name) = mode.strip_suffix(" by name").map_or((mode, false), |mode| (mode, true));
        let (mut gate, epoch) = match mode {
            "open" => (network.gate(&service(mode), &[]), 0),
            _ => (network.gate(&service(mode), &held), 3),
        };
        assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(epoch, 1, &TWIST)), Ok(1));
        let mut standing = network.standing(2, grants);
        if revoked {
            let barred = by_name.then(|| ("Org1/Salma".to_owned(), NOW));
            let salma = [&network.salma];
            let revoked: &[&User] = if by_name { &[] } else { &salma };
            standing.members = network.members(revoked);
            standing.members.barred = Arc::new(barred.into_iter().collect());
        }
        let service = Service { epoch, ..service(mode) };
        assert_eq!(gate.learn(&service, &standing, now().steady, now()), why, "{mode} {revoked}");
        assert_eq!(gate.is_moving(), why.is_none());
    }
}

#[test]
fn the_members_of_the_newest_standing_count() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &TWIST)), Ok(1));
    let other = Network::default();
    let mut standing = network.standing(2, &[]);
    standing.members = other.members(&[]);
    gate.learn(&service("open"), &standing, now().steady, now());
    let next = network.salma.set(0, 2, &TWIST);
    assert_eq!(deliver(&mut gate, &network.salma, &next), Err(Refused::Untrusted), "also if it was known before");
    assert!(Refused::Untrusted.may_pass_later(), "its organisation may be new");
}
