//! A clock of the robot's machine that is wrong for a while and is set right.

use super::*;
use crate::{gate::Now, standing::Standing};

const HOURS: u64 = 2 * 3600 * SECOND;

/// Both clocks so long after the start, with a wall clock that is two hours ahead.
fn ahead(after: u64) -> Now {
    Now { wall: NOW + after + HOURS, ..now_at(NOW + after) }
}

/// A gate that was opened while the wall clock was ahead.
fn opened_ahead(network: &Network) -> Gate {
    let mut gate = Gate::new(of_commands(network), "T/cmd_vel", ahead(0));
    ask(&mut gate, network, 0, ahead(0));
    gate
}

/// The voters answer so long after the start, in a block of then.
fn ask(gate: &mut Gate, network: &Network, after: u64, now: Now) {
    let standing = Standing { time: NOW + after, ..network.standing(gate.height + 1, &[]) };
    assert_eq!(gate.learn(&service("open"), &standing, now.steady, now), None);
}

/// Delivers a command that was signed so long after the start, and was in a block at once.
fn command(gate: &mut Gate, user: &User, seq: u64, signed: u64, now: Now) -> Result<(), Refused> {
    let user = User { not_after: NOW + signed + 2 * SECOND, ..user.clone() };
    let call = user.set(0, seq, &TWIST);
    let delivered = Delivered { block_time: NOW + signed, transaction: call.encoded(), certificate: &user.certificate };
    gate.pass(delivered, now).map(drop)
}

#[test]
fn a_robot_whose_clock_was_ahead_at_its_start_is_driven_once_the_clock_is_set_back() {
    let network = Network::default();
    let mut gate = opened_ahead(&network);
    let right = now_at(NOW + SECOND / 2);
    assert_eq!(command(&mut gate, &network.salma, 1, SECOND / 2, right), Ok(()));
    let mut gate = opened_ahead(&network);
    let before = User { not_after: NOW + 2 * SECOND - 1, ..network.salma.clone() };
    let signed = before.set(0, 1, &TWIST);
    let delivered =
        Delivered { block_time: NOW + SECOND / 2, transaction: signed.encoded(), certificate: &before.certificate };
    assert_eq!(gate.pass(delivered, right).map(drop), Err(Refused::BeforeStop), "signed before the start");
}

#[test]
fn a_stop_while_the_clock_was_ahead_lets_nothing_from_before_pass_and_all_from_after_it() {
    let network = Network::default();
    let mut gate = opened_ahead(&network);
    gate.stopped(ahead(SECOND));
    let later = SECOND + SECOND / 2;
    ask(&mut gate, &network, later, now_at(NOW + later));
    let right = now_at(NOW + later);
    assert_eq!(command(&mut gate, &network.salma, 1, SECOND - 1, right), Err(Refused::BeforeStop));
    assert_eq!(command(&mut gate, &network.salma, 1, SECOND, right), Ok(()));
}

#[test]
fn a_clock_that_is_set_forward_brings_back_nothing_from_before_a_stop() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    gate.stopped(now_at(NOW + SECOND / 2));
    let jumped = Now { wall: NOW + SECOND, ..now_at(NOW + SECOND / 2) };
    assert_eq!(command(&mut gate, &network.salma, 1, SECOND / 2 - 1, jumped), Err(Refused::BeforeStop));
    assert_eq!(command(&mut gate, &network.salma, 1, SECOND / 2, jumped), Ok(()));
}
