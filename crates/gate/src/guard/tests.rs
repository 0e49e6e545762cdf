//! A hand-over as the bridge sees it: events in, acts out.
#![expect(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::*;
use crate::fixture::{NOW, SECOND, TWIST, User, grant, now, service, shared};
use crate::gate::Refused;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_contract::{Direction, Grant};
use std::time::Duration;

/// A guard that has asked how its robot stands.
fn asking() -> Guard {
    let settings = Settings {
        network: shared().salma.network,
        sample_bytes_max: 1024,
        max_age: None,
        stale_after: Duration::from_secs(1),
        command_timeout: None,
    };
    let mut guard = Guard::new(settings, "T/cmd_vel", now());
    guard.ask(now());
    guard
}

/// A guard under which Salma drives in epoch 3.
fn driven() -> Guard {
    let (network, salma) = (shared(), &shared().salma);
    let mut guard = asking();
    let standing = network.standing(1, &[grant("Org1/Salma", 3)]);
    assert_eq!(guard.answered(&service("exclusive"), &standing, now().steady, now()), []);
    assert!(matches!(message(&mut guard, 2, salma, &salma.set(3, 1, &TWIST)), Some(Act::Publish(_))));
    guard
}

fn tell(
    guard: &mut Guard,
    height: u64,
    name: &str,
    payload: &str,
    signed: Option<(&User, &Transaction)>,
) -> Option<Act> {
    let none = Bytes::new();
    let (transaction, certificate) =
        signed.map_or((&none, &none), |(user, signed)| (signed.encoded(), &user.certificate));
    let payload = payload.as_bytes();
    let told = Told { index: 0, chaincode: crate::ABAC, name, payload, transaction, certificate };
    guard.told(&mut Block::new(height, NOW), &told, now())
}

fn message(guard: &mut Guard, height: u64, user: &User, signed: &Transaction) -> Option<Act> {
    tell(guard, height, "message", "", Some((user, signed)))
}

/// The end of Salma's grant, after which the next one goes on, or nobody does.
fn end(guard: &mut Guard, goes_on: &str) -> Option<Act> {
    let payload = format!(r#"{{"service":"T/cmd_vel","holder":"Org1/Salma","epoch":3,"reason":"delegated"{goes_on}}}"#);
    tell(guard, 3, "released", &payload, None)
}

#[test]
fn a_speed_that_is_no_number_ends_the_motion_and_the_next_command_moves_the_robot_again() {
    let mut guard = driven();
    let salma = &shared().salma;
    let twist = |speed: f64| -> Bytes {
        [0, 1, 0, 0]
            .into_iter()
            .chain([speed, 0.0, 0.0, 0.0, 0.0, 0.0].into_iter().flat_map(f64::to_le_bytes))
            .collect()
    };
    assert!(guard.gate().is_moving() && guard.stop_at().is_some());
    let act = message(&mut guard, 3, salma, &salma.set(3, 2, &[twist(f64::NAN)]));
    assert_eq!(act, Some(Act::Refused { refused: Refused::BadSpeed, height: 3 }));
    assert!(Refused::BadSpeed.stops() && !guard.gate().is_moving() && guard.stop_at().is_none());
    assert!(matches!(message(&mut guard, 4, salma, &salma.set(3, 2, &[twist(0.5)])), Some(Act::Publish(_))));
    assert!(guard.gate().is_moving());
    // One of those who do not hold it moves and stops nothing.
    let farhad = &shared().farhad;
    let act = message(&mut guard, 5, farhad, &farhad.set(3, 3, &[twist(f64::NAN)]));
    assert_eq!(act, Some(Act::Refused { refused: Refused::NotHolder, height: 5 }));
    assert!(guard.gate().is_moving() && !Refused::NotHolder.stops());
}

#[test]
fn a_hand_over_is_asked_about_at_once_and_the_next_drivers_messages_wait_for_the_answer() {
    let farhad = &shared().farhad;
    let mut guard = driven();
    assert_eq!(end(&mut guard, r#","goes_on":true"#), None, "no stop");
    assert!(guard.asks_at().unwrap() <= now().steady + 50_000);
    assert_eq!(guard.ask(now()), now().steady, "an answer from before does not count");
    assert_eq!(message(&mut guard, 4, farhad, &farhad.set(4, 1, &TWIST)), None, "it waits");
    let next = Grant { follows: Some(3), ..grant("Org1/Farhad", 4) };
    let acts = guard.answered(&service("exclusive"), &shared().standing(5, &[next]), now().steady, now());
    assert!(matches!(&acts[..], [Act::Publish(passed)] if passed.samples.len() == 1), "{acts:?}");
}

#[test]
fn an_end_without_a_next_one_stops_at_once_and_a_made_up_hand_over_at_the_answer_or_when_none_comes() {
    assert_eq!(end(&mut driven(), ""), Some(Act::Stop("delegated")));
    let ended = Service { epoch: 3, ..service("exclusive") };
    let mut guard = driven();
    assert_eq!(end(&mut guard, r#","goes_on":true"#), None);
    let salma = &shared().salma;
    let refused = message(&mut guard, 4, salma, &salma.set(3, 2, &TWIST));
    assert_eq!(refused, Some(Act::Refused { refused: Refused::NotHolder, height: 4 }));
    assert_eq!(guard.stop_at().unwrap().0, now().steady + SECOND, "no later than without it");
    guard.ask(now());
    let acts = guard.answered(&ended, &shared().standing(5, &[]), now().steady, now());
    assert_eq!(acts, [Act::Stop("released")]);
}

#[test]
fn a_message_ahead_of_a_slow_clock_waits_for_the_voters_who_are_asked_once_whatever_they_say() {
    let (network, robot) = (shared(), &shared().robot);
    let feed = Service { direction: Direction::Feed, ..service("open") };
    let ahead = NOW + 600 * SECOND;
    let of_then = |time, height| Standing { time, ..network.standing(height, &[]) };
    for is_latched in [false, true] {
        let mut guard = asking();
        assert_eq!(guard.answered(&feed, &of_then(NOW, 1), now().steady, now()), []);
        assert_eq!(guard.asks_at(), None);
        let said = User { not_after: ahead + 2 * SECOND, ..robot.clone() };
        for (time, height, passes) in [(NOW, 2, false), (ahead, 3, true)] {
            let block: fn(u64, u64) -> Block = if is_latched { Block::latched } else { Block::new };
            let signed = said.set(0, height, &TWIST);
            let told = Told {
                index: 0,
                chaincode: crate::ABAC,
                name: "message",
                payload: b"",
                transaction: signed.encoded(),
                certificate: &said.certificate,
            };
            assert_eq!(guard.told(&mut block(height, ahead), &told, now()), None, "it waits");
            assert!(guard.asks_at().is_some());
            guard.ask(now());
            let acts = guard.answered(&feed, &of_then(time, height), now().steady, now());
            match &acts[..] {
                [Act::Publish(_)] => assert!(passes, "the voters have signed that time"),
                [Act::Refused { refused: Refused::FromFuture, .. }] => assert!(!passes, "only a node has told it"),
                other => panic!("{other:?}"),
            }
            assert_eq!(guard.asks_at(), None, "it is not asked again about the same message");
        }
    }
}

#[test]
fn a_signed_stop_is_asked_about_until_it_is_settled_also_while_the_robot_rests() {
    let network = shared();
    let mut guard = driven();
    let stop = network.robot.sign("abac", "stop", vec![Bytes::from_static(b"T")]);
    let told = |guard: &mut Guard| tell(guard, 3, "stopped", "", Some((&network.robot, &stop)));
    assert_eq!(told(&mut guard), Some(Act::Stop("stopped")));
    let standing = |height| network.standing(height, &[grant("Org1/Salma", 3)]);
    for height in 4..8 {
        assert!(guard.asks_at().is_some());
        assert_eq!(guard.open_stops().collect::<Vec<_>>(), [stop.call_ref()]);
        let asked = guard.ask(now()).max(now().steady);
        assert_eq!(guard.answered(&service("exclusive"), &standing(height), asked, now()), []);
    }
    guard.ask(now());
    let settled = Standing { settled: [stop.id()].into(), ..standing(8) };
    assert_eq!(guard.answered(&service("exclusive"), &settled, now().steady, now()), []);
    assert_eq!((guard.asks_at(), guard.open_stops().count()), (None, 0), "it has a verdict");
}
