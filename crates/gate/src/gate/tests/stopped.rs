//! A stopped robot takes no commands, whatever grants stand.

use super::*;
use crate::standing::Standing;

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
fn a_stop_that_a_node_tells_of_counts_at_once_and_the_next_answer_decides() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    let (earlier, later) = (now_at(NOW + 1000), now_at(NOW + 2000));
    assert!(gate.halt(earlier), "also a robot that nobody moves");
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
    assert!(gate.halt(now()), "early");
    assert!(!gate.released(&released("Org1/Salma", 3), NOW, now()) && !gate.halt(now()), "its block");
    // A stop that nobody ordered: the voters say that she holds the robot, and then it is stopped in earnest.
    gate.learn(&service("exclusive"), &network.standing(2, &[grant("Org1/Salma", 3)]), now().steady, now());
    assert_eq!(moves(&mut gate, 2), Ok(1));
    assert!(gate.halt(now()), "it moves, so it is told");
}

#[test]
fn a_feed_goes_on_while_its_robot_is_stopped() {
    let network = Network::default();
    let feed = Service { direction: Direction::Feed, ..service("open") };
    let mut gate = network.gate(&feed, &[]);
    assert!(!gate.halt(now()));
    gate.learn(&feed, &stopped(&network, 2), now().steady, now());
    assert_eq!(deliver(&mut gate, &network.robot, &network.robot.set(0, 1, &TWIST)), Ok(1));
}
