//! A stopped robot takes no commands, whatever grants stand.

use super::*;
use crate::standing::Standing;
use ledger_base::hash::Hash;
use std::collections::BTreeSet;

fn stopped(network: &Network, height: u64) -> Standing {
    Standing { stopped: true, ..network.standing(height, &[grant("Org1/Salma", 3)]) }
}

#[test]
fn no_command_passes_while_the_voters_say_that_the_robot_is_stopped() {
    for (mode, epoch) in [("exclusive", 3), ("open", 0)] {
        let network = Network::default();
        let mut gate = network.gate(&service(mode), &[grant("Org1/Salma", 3)]);
        assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(epoch, 1, &TWIST)), Ok(1));
        let over = gate.learn(&service(mode), &stopped(&network, 2), now().steady, now());
        assert_eq!((over, gate.is_moving()), (Some("stopped"), false));
        let next = network.salma.set(epoch, 2, &TWIST);
        assert_eq!(deliver(&mut gate, &network.salma, &next), Err(Refused::Stopped));
        let standing = network.standing(3, &[grant("Org1/Salma", 3)]);
        assert_eq!(gate.learn(&service(mode), &standing, now().steady, now()), None);
        assert_eq!(deliver(&mut gate, &network.salma, &next), Ok(1), "{mode}: it goes on once the robot is resumed");
    }
}

#[test]
fn a_stop_without_its_signed_call_counts_at_once_and_the_next_answer_decides() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    let (earlier, later) = (now_at(NOW + 1000), now_at(NOW + 2000));
    assert!(gate.halt(&Bytes::new(), earlier), "also a robot that nobody moves");
    let sent = User { not_after: network.salma.not_after + SECOND, ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &sent, &sent.set(0, 1, &TWIST)), Err(Refused::Stopped));
    gate.learn(&service("open"), &network.standing(2, &[]), now().steady, later);
    assert_eq!(deliver(&mut gate, &sent, &sent.set(0, 1, &TWIST)), Err(Refused::Stopped), "asked before it was told");
    gate.learn(&service("open"), &network.standing(2, &[]), later.steady, later);
    let after = now_at(NOW + 3000);
    let signed = sent.set(0, 1, &TWIST);
    let delivered = Delivered { block_time: NOW + 3000, transaction: signed.encoded(), certificate: &sent.certificate };
    assert!(gate.pass(delivered, after).is_ok(), "a node that lies about a stop keeps nobody stopped");
}

#[test]
fn a_robot_that_was_stopped_early_is_not_told_again_by_the_block_unless_it_may_move_meanwhile() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let moves = |gate: &mut Gate, seq| deliver(gate, &network.salma, &network.salma.set(3, seq, &TWIST));
    assert_eq!(moves(&mut gate, 1), Ok(1));
    assert!(gate.halt(&Bytes::new(), now()), "early");
    assert!(!gate.released(&released("Org1/Salma", 3), NOW, now()) && !gate.halt(&Bytes::new(), now()), "its block");
    // A stop that nobody ordered: the voters say that she holds the robot, and then it is stopped in earnest.
    gate.learn(&service("exclusive"), &network.standing(2, &[grant("Org1/Salma", 3)]), now().steady, now());
    assert_eq!(moves(&mut gate, 2), Ok(1));
    assert!(gate.halt(&Bytes::new(), now()), "it moves, so it is told");
}

#[test]
fn a_feed_goes_on_while_its_robot_is_stopped() {
    let network = Network::default();
    let feed = Service { direction: Direction::Feed, ..service("open") };
    let mut gate = network.gate(&feed, &[]);
    assert!(!gate.halt(&Bytes::new(), now()));
    gate.learn(&feed, &stopped(&network, 2), now().steady, now());
    assert_eq!(deliver(&mut gate, &network.robot, &network.robot.set(0, 1, &TWIST)), Ok(1));
}

/// A stop that its robot's owner has signed, and the standing that settles it.
fn signed_stop(network: &Network) -> Transaction {
    network.robot.sign("abac", "stop", vec![Bytes::from_static(b"T")])
}

#[test]
fn a_signed_stop_lasts_whatever_standings_say_until_one_settles_it_by_its_id() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let moves = |gate: &mut Gate, seq| deliver(gate, &network.salma, &network.salma.set(3, seq, &TWIST));
    let standing = |height| network.standing(height, &[grant("Org1/Salma", 3)]);
    assert_eq!(moves(&mut gate, 1), Ok(1));
    let stop = signed_stop(&network);
    assert!(gate.halt(stop.encoded(), now()));
    for height in 2..10 {
        let other = BTreeSet::from([Hash::of(&[b"another call"])]);
        let unsettled = Standing { settled: other, ..standing(height) };
        gate.learn(&service("exclusive"), &unsettled, now().steady, now());
        assert_eq!(moves(&mut gate, 2), Err(Refused::Stopped), "the holder still holds it, as the voters say");
        assert_eq!(gate.open_stops().collect::<Vec<_>>(), [stop.call_ref()], "it is asked for");
    }
    let settled = Standing { settled: BTreeSet::from([stop.id()]), ..standing(10) };
    gate.learn(&service("exclusive"), &settled, now().steady, now());
    assert!(!gate.has_open_stops());
    assert_eq!(moves(&mut gate, 2), Ok(1), "its verdict was a rejection, or it was resumed");
}

#[test]
fn a_signed_stop_that_was_ordered_stops_until_it_is_resumed() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let stop = signed_stop(&network);
    assert!(gate.halt(stop.encoded(), now()));
    let settled = BTreeSet::from([stop.id()]);
    gate.learn(&service("exclusive"), &Standing { settled, ..stopped(&network, 2) }, now().steady, now());
    assert!(!gate.has_open_stops());
    let next = network.salma.set(3, 1, &TWIST);
    assert_eq!(deliver(&mut gate, &network.salma, &next), Err(Refused::Stopped));
}

#[test]
fn a_signed_stop_is_over_once_certified_block_time_has_passed_its_not_after() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[]);
    let stop = signed_stop(&network);
    assert!(gate.halt(stop.encoded(), now()));
    let not_after = stop.call_ref().not_after;
    for (height, time, is_open) in [(2, not_after, true), (3, not_after + 1, false)] {
        let standing = Standing { time, ..network.standing(height, &[]) };
        gate.learn(&service("exclusive"), &standing, now().steady, now());
        assert_eq!(gate.has_open_stops(), is_open);
    }
}

#[test]
fn another_call_or_one_of_another_network_is_no_signed_stop() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[]);
    let elsewhere = User { network: Hash([9; 32]), ..network.robot.clone() };
    for call in [network.salma.set(3, 1, &TWIST), elsewhere.sign("abac", "stop", vec![Bytes::from_static(b"T")])] {
        gate.halt(call.encoded(), now());
        assert!(!gate.has_open_stops());
    }
}
