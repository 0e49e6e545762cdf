//! The age of messages that name the newest block that their signer knew, with clocks apart.

use super::*;
use crate::{gate::Now, standing::Standing};
use ledger::transaction::KnownBlock;

const MS: u64 = 1_000;
/// How old a command of the service may be, microseconds.
const MAX_AGE: u64 = 500 * MS;
/// The bound between clocks, microseconds.
const BOUND: i64 = 2_000_000;

/// A gate, and clocks that differ. Times are microseconds of the right time since the start.
struct Scene {
    network: Network,
    gate: Gate,
    /// How far the clock of the robot's machine is ahead.
    robot: i64,
    /// How far block time is ahead: the clock of the leader.
    leader: i64,
    /// How far the clock is ahead by which the signer dates.
    signer: i64,
    seq: u64,
}

/// A command: when it was signed, by which block, and how long the signer had known that one; when it was in a block.
#[derive(Clone, Copy)]
struct Command {
    signed: u64,
    block: u64,
    known: u64,
    ordered: u64,
}

fn at(time: u64, ahead: i64) -> u64 {
    (NOW + time).saturating_add_signed(ahead)
}

fn hash(height: u64) -> [u8; 8] {
    (height ^ 0x5a5a_5a5a).to_be_bytes()
}

impl Scene {
    fn new(robot: i64, leader: i64, signer: i64) -> Self {
        let network = Network::default();
        let service = Service { max_age_ms: MAX_AGE / MS, ..service("open") };
        let now = Now { wall: at(0, robot), steady: SECOND };
        let settings = of_commands(&network);
        let mut scene = Self { gate: Gate::new(settings, "T/cmd_vel", now), network, robot, leader, signer, seq: 0 };
        scene.learn(&service, 1, 0);
        scene
    }

    fn now(&self, time: u64) -> Now {
        Now { wall: at(time, self.robot), steady: SECOND + time }
    }

    /// The voters answer a question of that moment at once, in a block of this height.
    fn learn(&mut self, service: &Service, height: u64, time: u64) {
        let standing = Standing { time: at(time, self.leader), ..self.network.standing(height, &[]) };
        let now = self.now(time);
        assert_eq!(self.gate.learn(service, &standing, now.steady, now), None);
    }

    /// The node reports these blocks.
    fn reported(&mut self, heights: std::ops::RangeInclusive<u64>, time: u64) {
        let last = *heights.end();
        let hashes: Vec<u8> = heights.flat_map(hash).collect();
        self.gate.heads(last, &hashes, self.now(time));
    }

    /// The command arrives in its block.
    fn arrives(&mut self, command: Command, time: u64) -> Result<(), Refused> {
        let Command { signed, block, known, ordered } = command;
        self.seq += 1;
        let named = KnownBlock { height: block, hash: Bytes::copy_from_slice(&hash(block)), known_us: known };
        let user = User {
            not_after: at(signed, self.signer) + 2 * SECOND,
            known_block: Some(named),
            ..self.network.salma.clone()
        };
        let call = user.set(0, self.seq, &TWIST);
        let delivered = Delivered {
            block_time: at(ordered, self.leader),
            transaction: call.encoded(),
            certificate: &user.certificate,
        };
        self.gate.pass(delivered, self.now(time)).map(drop)
    }
}

/// All pairs of clocks within the bound, of which no two are further apart than voters acknowledge.
fn clocks() -> impl Iterator<Item = (i64, i64, i64)> {
    let all = [-BOUND, -600_000, 0, 600_000, BOUND];
    all.into_iter().flat_map(move |robot| {
        [-600_000, 0, 600_000]
            .into_iter()
            .flat_map(move |leader| [-600_000, 0, 600_000].map(|signer| (robot, leader, signer)))
    })
}

#[test]
fn a_command_is_as_old_as_it_is_whatever_the_clocks_of_robot_leader_and_signer_say() {
    for (robot, leader, signer) in clocks() {
        let mut scene = Scene::new(robot, leader, signer);
        scene.reported(5..=6, 50 * MS);
        // Signed 40 ms after the signer has heard of block 6; the network goes on.
        let command = Command { signed: 90 * MS, block: 6, known: 40 * MS, ordered: 100 * MS };
        scene.reported(7..=7, 100 * MS);
        let clocks = format!("robot {robot}, leader {leader}, signer {signer}");
        assert_eq!(scene.arrives(command, 110 * MS), Ok(()), "{clocks}");
        assert_eq!(scene.arrives(command, 590 * MS), Ok(()), "not too old yet: {clocks}");
        assert_eq!(scene.arrives(command, 601 * MS), Err(Refused::TooOld), "{clocks}");
    }
}

#[test]
fn a_command_that_the_leader_held_back_is_too_old_though_its_block_is_new() {
    for (robot, leader, signer) in clocks() {
        let mut scene = Scene::new(robot, leader, signer);
        scene.reported(5..=6, 50 * MS);
        scene.reported(7..=9, 120 * MS);
        let held_back = Command { signed: 90 * MS, block: 6, known: 40 * MS, ordered: 700 * MS };
        scene.reported(10..=10, 700 * MS);
        assert_eq!(scene.arrives(held_back, 701 * MS), Err(Refused::TooOld), "robot {robot}, leader {leader}");
    }
}

#[test]
fn the_first_command_after_a_minute_without_a_block_passes_and_so_does_that_of_a_signer_who_came_late() {
    let minute = 60 * SECOND;
    for known in [minute, 10 * MS] {
        let mut scene = Scene::new(0, 600_000, 0);
        scene.reported(5..=6, 0);
        // Signs of life, and no block.
        for time in (0..minute).step_by(250_000) {
            scene.gate.heads(6, &[], scene.now(time));
        }
        scene.reported(7..=7, minute + 10 * MS);
        scene.learn(&Service { max_age_ms: MAX_AGE / MS, ..service("open") }, 8, minute + 20 * MS);
        let first = Command { signed: minute, block: 6, known, ordered: minute + 10 * MS };
        assert_eq!(scene.arrives(first, minute + 30 * MS), Ok(()), "its own block is the next one");
        assert_eq!(scene.arrives(first, minute + 600 * MS), Err(Refused::TooOld));
    }
}

#[test]
fn a_robot_at_rest_takes_no_old_command_from_a_node_that_was_cut_off() {
    let minute = 60 * SECOND;
    for (robot, leader, signer) in clocks() {
        let mut scene = Scene::new(robot, leader, signer);
        let service = Service { max_age_ms: MAX_AGE / MS, ..service("open") };
        scene.reported(5..=6, 0);
        for time in (0..minute).step_by(250_000) {
            scene.gate.heads(6, &[], scene.now(time));
        }
        // The network made blocks 7 to 10 meanwhile. The robot asks when they arrive, and its question is in block 11.
        scene.reported(7..=10, minute);
        scene.learn(&service, 11, minute + 10 * MS);
        let clocks = format!("robot {robot}, leader {leader}, signer {signer}");
        for ago in [4, 12, 50] {
            let signed = minute - ago * SECOND;
            let late = Command { signed, block: 8, known: 10 * MS, ordered: signed + 20 * MS };
            assert_eq!(scene.arrives(late, minute + 20 * MS), Err(Refused::TooOld), "{ago} s old: {clocks}");
        }
        let new = Command { signed: minute, block: 10, known: 10 * MS, ordered: minute + 5 * MS };
        assert_eq!(scene.arrives(new, minute + 20 * MS), Ok(()), "{clocks}");
    }
}

#[test]
fn a_command_that_names_a_block_behind_a_question_passes_though_block_time_jumps_ahead() {
    let mut scene = Scene::new(0, 0, 0);
    let service = Service { max_age_ms: MAX_AGE / MS, ..service("open") };
    scene.reported(5..=5, 50 * MS);
    scene.learn(&service, 6, 60 * MS);
    scene.reported(6..=7, 100 * MS);
    let command = Command { signed: 90 * MS, block: 6, known: 10 * MS, ordered: 100 * MS };
    // Another leader, with a clock far ahead.
    scene.leader = 3 * BOUND;
    scene.learn(&service, 8, 110 * MS);
    scene.leader = 0;
    assert_eq!(scene.arrives(command, 120 * MS), Ok(()));
}

#[test]
fn nothing_from_before_a_stop_passes_and_what_is_signed_after_it_does_whatever_the_clocks_say() {
    for (robot, leader, signer) in clocks() {
        let mut scene = Scene::new(robot, leader, signer);
        scene.reported(5..=6, 50 * MS);
        scene.gate.stopped(scene.now(100 * MS));
        scene.reported(7..=7, 102 * MS);
        let before = Command { signed: 90 * MS, block: 6, known: 40 * MS, ordered: 102 * MS };
        assert_eq!(scene.arrives(before, 103 * MS), Err(Refused::BeforeStop));
        let after = Command { signed: 103 * MS, block: 6, known: 53 * MS, ordered: 104 * MS };
        assert_eq!(scene.arrives(after, 105 * MS), Ok(()), "robot {robot}, leader {leader}, signer {signer}");
    }
}

#[test]
fn a_block_that_the_gate_does_not_know_lets_nothing_pass() {
    let mut scene = Scene::new(0, 0, 0);
    scene.reported(5..=6, 50 * MS);
    let ahead = Command { signed: 60 * MS, block: 99, known: 0, ordered: 70 * MS };
    assert_eq!(scene.arrives(ahead, 80 * MS), Err(Refused::UnknownBlock), "a node has made it up");
}

#[test]
fn what_passed_before_the_bridge_started_anew_does_not_pass_again_when_its_node_lags() {
    let network = Network::default();
    let service = Service { max_age_ms: MAX_AGE / MS, ..service("open") };
    let now = Now { wall: at(0, 0), steady: SECOND };
    let gate = Gate::new(of_commands(&network), "T/cmd_vel", now);
    let mut scene = Scene { gate, network, robot: 0, leader: 0, signer: 0, seq: 0 };
    // Block 6 is older than the gate, and comes after it was opened. The first question is in block 8.
    scene.reported(5..=7, 50 * MS);
    scene.reported(8..=8, 70 * MS);
    scene.learn(&service, 8, 60 * MS);
    let mut earlier = Scene { seq: 1, ..scene };
    let user = User {
        not_after: NOW - 100 * MS + 2 * SECOND,
        known_block: Some(KnownBlock { height: 6, hash: Bytes::copy_from_slice(&hash(6)), known_us: 40 * MS }),
        ..earlier.network.salma.clone()
    };
    let call = user.set(0, 1, &TWIST);
    let (transaction, certificate) = (call.encoded(), &user.certificate);
    let delivered = Delivered { block_time: NOW - 90 * MS, transaction, certificate };
    assert_eq!(earlier.gate.pass(delivered, earlier.now(80 * MS)).map(drop), Err(Refused::BeforeStop));
    let new = Command { signed: 75 * MS, block: 8, known: 5 * MS, ordered: 78 * MS };
    assert_eq!(earlier.arrives(new, 80 * MS), Ok(()));
}

#[test]
fn a_message_that_names_a_block_from_before_the_gate_is_judged_by_clocks() {
    let mut scene = Scene::new(0, 0, 0);
    scene.reported(5..=6, 50 * MS);
    let early = Command { signed: 60 * MS, block: 3, known: 60 * MS, ordered: 70 * MS };
    assert_eq!(scene.arrives(early, 80 * MS), Ok(()));
    assert_eq!(scene.arrives(early, 600 * MS), Err(Refused::TooOld));
}
