//! The next driver goes on where the last one ends, if the voters have signed that.

use super::*;
use crate::fixture::shared;

fn goes_on(holder: &str, epoch: u64) -> Released {
    Released { goes_on: true, reason: "delegated".into(), ..released(holder, epoch) }
}

/// A grant of Farhad in epoch 4 that follows this one, for two seconds.
fn following(follows: Option<u64>) -> Grant {
    Grant { follows, expires: NOW + 2 * SECOND, ..grant("Org1/Farhad", 4) }
}

/// A gate through which Salma drives in epoch 3.
fn driven(mode: &str) -> Gate {
    let (network, salma) = (shared(), &shared().salma);
    let mut gate = network.gate(&service(mode), &[grant("Org1/Salma", 3)]);
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 1, &TWIST)), Ok(1));
    gate
}

#[test]
fn a_robot_that_is_handed_over_goes_on_and_hears_only_the_next_driver() {
    let network = shared();
    let (salma, farhad) = (&network.salma, &network.farhad);
    for mode in ["exclusive", "open"] {
        let mut gate = driven(mode);
        assert!(!gate.released(&goes_on("Org1/Salma", 3), NOW, now()), "no stop");
        assert_eq!(deliver(&mut gate, salma, &salma.set(3, 2, &TWIST)), Err(Refused::NotHolder), "at once");
        assert_eq!(deliver(&mut gate, farhad, &farhad.set(4, 1, &TWIST)), Err(Refused::UnknownEpoch));
        assert_eq!(gate.deadline(), Some(now().steady + 4 * SECOND), "until the voters say so, by the old lease");
        assert_eq!(learn(&mut gate, network, &service(mode), &[following(Some(3))]), None);
        assert_eq!(
            gate.deadline(),
            Some(now().steady + 2 * SECOND),
            "by the lease of the next one, though it is shorter"
        );
        let from_before = deliver_at(&mut gate, farhad, &farhad.set(4, 1, &TWIST), NOW - 1);
        assert_eq!(from_before, Ok(1), "there was no stop: what is on its way counts");
        assert!(deliver(&mut gate, salma, &salma.set(3, 2, &TWIST)).is_err());
        assert!(gate.released(&released("Org1/Farhad", 4), NOW, now()), "the end of the next one is an end");
        assert_eq!(gate.fault(), None);
    }
}

#[test]
fn a_hand_over_of_which_no_event_tells_is_none_the_less_one() {
    let mut gate = driven("exclusive");
    assert_eq!(learn(&mut gate, shared(), &service("exclusive"), &[following(Some(3))]), None);
    assert!(gate.is_moving());
    let salma = &shared().salma;
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 2, &TWIST)), Err(Refused::StaleEpoch));
}

#[test]
fn without_a_live_successor_of_the_driver_the_robot_stops_at_the_next_answer() {
    let over = Grant { expires: NOW, ..following(Some(3)) };
    for grants in [vec![], vec![following(None)], vec![following(Some(2))], vec![over]] {
        for told in [false, true] {
            let mut gate = driven("exclusive");
            if told {
                assert!(!gate.released(&goes_on("Org1/Salma", 3), NOW, now()));
                assert!(gate.is_moving());
            }
            let service = Service { epoch: 4, ..service("exclusive") };
            assert_eq!(learn(&mut gate, shared(), &service, &grants), Some("released"), "{grants:?}");
            assert!(!gate.is_moving());
        }
    }
}

#[test]
fn a_node_that_makes_up_a_hand_over_wins_nothing_beyond_the_next_answer() {
    let (network, salma) = (shared(), &shared().salma);
    let held = [grant("Org1/Salma", 3)];
    let mut gate = driven("exclusive");
    let fresh = gate.fresh_until();
    assert!(!gate.released(&goes_on("Org1/Salma", u64::MAX), u64::MAX, now()));
    assert_eq!(gate.fresh_until(), fresh, "it buys no time");
    let before = now().steady - 1;
    assert_eq!(gate.learn(&service("exclusive"), &network.standing(2, &held), before, now()), None);
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 2, &TWIST)), Err(Refused::NotHolder), "asked for before");
    // The truth: nothing has ended.
    assert_eq!(learn(&mut gate, network, &service("exclusive"), &held), None);
    assert_eq!(deliver(&mut gate, salma, &salma.set(3, 2, &TWIST)), Ok(1));
}

#[test]
fn who_moved_it_last_was_revoked_so_it_stops_whoever_took_over() {
    let network = shared();
    let mut gate = driven("exclusive");
    let mut standing = network.standing(2, &[following(Some(3))]);
    standing.members = network.members(&[&network.salma]);
    assert_eq!(gate.learn(&service("exclusive"), &standing, now().steady, now()), Some("revoked"));
    let mut gate = driven("exclusive");
    assert_eq!(learn(&mut gate, network, &service("exclusive"), &[following(Some(3))]), None);
    assert!(gate.revoked(&network.salma.revocation(network), now()), "nobody has commanded it since");
}

#[test]
fn what_was_taken_back_goes_on_with_the_giver() {
    let (network, salma) = (shared(), &shared().salma);
    let mut gate = driven("exclusive");
    assert_eq!(learn(&mut gate, network, &service("exclusive"), &[following(Some(3))]), None);
    assert!(!gate.released(&goes_on("Org1/Farhad", 4), NOW, now()));
    let back = Grant { follows: Some(4), ..grant("Org1/Salma", 5) };
    assert_eq!(learn(&mut gate, network, &service("exclusive"), &[back]), None);
    assert_eq!(deliver(&mut gate, salma, &salma.set(5, 1, &TWIST)), Ok(1));
}

#[test]
fn a_stopped_robot_is_handed_over_standing_still() {
    let network = shared();
    let mut gate = driven("exclusive");
    let standing = crate::standing::Standing { stopped: true, ..network.standing(2, &[following(Some(3))]) };
    assert_eq!(gate.learn(&service("exclusive"), &standing, now().steady, now()), Some("stopped"));
}
