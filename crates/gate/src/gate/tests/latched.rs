//! Messages for those who come late to a feed.

use super::*;

fn feed() -> Service {
    Service { direction: Direction::Feed, ..service("open") }
}

/// Delivers a message of long ago, in its block.
fn late(gate: &mut Gate, user: &User, transaction: &Transaction) -> Result<usize, Refused> {
    let block_time = transaction.body().not_after - 2 * SECOND;
    let delivered = Delivered { block_time, transaction: transaction.encoded(), certificate: &user.certificate };
    gate.pass_latched(delivered, now()).map(|passed| passed.samples.len())
}

fn hour_ago(user: &User) -> User {
    User { not_after: user.not_after - 3600 * SECOND, ..user.clone() }
}

#[test]
fn a_message_of_a_feed_passes_late_however_old_it_is_and_none_before_the_last_that_passed() {
    let network = Network::default();
    let mut gate = network.gate(&feed(), &[]);
    let robot = hour_ago(&network.robot);
    let before = robot.set(0, 1, &TWIST);
    assert_eq!(deliver(&mut gate, &robot, &before), Err(Refused::Expired), "as news it is too old");
    assert_eq!(late(&mut gate, &robot, &before), Ok(1));
    assert_eq!(late(&mut gate, &robot, &before), Ok(1), "another one comes late");
    assert_eq!(deliver(&mut gate, &network.robot, &network.robot.set(0, 1, &TWIST)), Err(Refused::StaleSequence));
    assert_eq!(deliver(&mut gate, &network.robot, &network.robot.set(0, 2, &TWIST)), Ok(1));
    assert_eq!(late(&mut gate, &robot, &before), Err(Refused::StaleSequence), "a newer one passed");
}

#[test]
fn a_node_makes_up_no_latched_message() {
    let network = Network::default();
    let mut gate = network.gate(&feed(), &[]);
    let (robot, salma) = (hour_ago(&network.robot), hour_ago(&network.salma));
    assert_eq!(late(&mut gate, &salma, &salma.set(0, 1, &TWIST)), Err(Refused::NotOwner));
    let forger = User { key: network.farhad.key.clone(), ..robot.clone() };
    assert_eq!(late(&mut gate, &robot, &forger.set(0, 1, &TWIST)), Err(Refused::BadSignature));
    let foreign = User { network: network.robot.network, ..hour_ago(&Network::default().robot) };
    assert_eq!(late(&mut gate, &foreign, &foreign.set(0, 1, &TWIST)), Err(Refused::Untrusted));
    // A block of a time for which it was not signed, such as one in which a certificate was still valid.
    let signed = robot.set(0, 1, &TWIST);
    for block_time in [robot.not_after + 1, robot.not_after - 600 * SECOND] {
        let delivered =
            Delivered { block_time, transaction: signed.encoded(), certificate: &network.robot.certificate };
        assert_eq!(gate.pass_latched(delivered, now()), Err(Refused::Expired), "{block_time}");
    }
    let revoked = network.robot.revocation(&network);
    gate.revoked(&revoked, now());
    assert_eq!(late(&mut gate, &robot, &signed), Err(Refused::Revoked));
}

#[test]
fn no_command_passes_late() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    let salma = &network.salma;
    assert_eq!(late(&mut gate, salma, &salma.set(0, 1, &TWIST)), Err(Refused::TooOld), "not even a new one");
    assert_eq!(deliver(&mut gate, salma, &salma.set(0, 1, &TWIST)), Ok(1));
}
