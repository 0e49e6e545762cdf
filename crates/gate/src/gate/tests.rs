//! Each rule of the gate has a test that fails without it.
#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod age;
mod clocks;
mod confidential;
mod faults;
mod handover;
mod latched;
mod limits;
mod standing;
mod stopped;

use crate::fixture::{NOW, Network, SECOND, TWIST, User, grant, now, now_at, service};
use bytes::Bytes;
use ledger::transaction::Transaction;
use proptest::prelude::*;

use super::{Bound, Delivered, Gate, HOLDERS_MAX, Refused, Settings};
use crate::service::{Released, Revoked, Service};
use ledger_contract::{Capabilities, Direction, Fencing, Grant, Publishing, Sequence};

/// Settings as a route of commands has them, in this network.
fn of_commands(network: &Network) -> Settings {
    Settings {
        network: network.salma.network,
        sample_bytes_max: 1024,
        max_age: None,
        stale_after: std::time::Duration::from_secs(1),
        command_timeout: None,
    }
}

/// Delivers a transaction in a block of now, with the certificate.
fn deliver(gate: &mut Gate, user: &User, transaction: &Transaction) -> Result<usize, Refused> {
    deliver_at(gate, user, transaction, NOW)
}

fn deliver_at(gate: &mut Gate, user: &User, transaction: &Transaction, block_time: u64) -> Result<usize, Refused> {
    let delivered = Delivered { block_time, transaction: transaction.encoded(), certificate: &user.certificate };
    gate.pass(delivered, now()).map(|passed| passed.samples.len())
}

/// Tells the gate of a newer standing, as the answer to a question of now.
fn learn(gate: &mut Gate, network: &Network, service: &Service, grants: &[Grant]) -> Option<&'static str> {
    gate.learn(service, &network.standing(gate.height + 1, grants), now().steady, now())
}

fn released(holder: &str, epoch: u64) -> Released {
    Released { service: "T/cmd_vel".into(), holder: holder.into(), epoch, reason: "released".into(), goes_on: false }
}

#[test]
fn what_the_holder_signed_passes_byte_for_byte_and_in_order() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let payloads = [Bytes::from_static(&[0, 1, 0, 0, 1]), Bytes::from_static(&[0, 0, 0, 0, 2])];
    let signed = network.salma.set(3, 1, &payloads);
    let delivered =
        Delivered { block_time: NOW, transaction: signed.encoded(), certificate: &network.salma.certificate };
    let samples = gate.pass(delivered, now()).unwrap().samples;
    assert_eq!(samples.iter().map(|sample| sample.wire().clone()).collect::<Vec<_>>(), payloads);
    assert!(gate.is_moving());
}

#[test]
fn a_certificate_is_shown_once() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let stranger = User { certificate: Bytes::new(), ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &stranger, &network.salma.set(3, 1, &TWIST)), Err(Refused::UnknownCreator));
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Ok(1));
    assert_eq!(deliver(&mut gate, &stranger, &network.salma.set(3, 2, &TWIST)), Ok(1));
}

#[test]
fn a_certificate_that_came_with_another_event_is_kept_and_still_has_to_be_of_the_network() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    let foreign = User { network: network.salma.network, ..Network::default().salma };
    for (user, passes) in [(&network.salma, Ok(1)), (&foreign, Err(Refused::Untrusted))] {
        gate.show(&user.certificate);
        let bare = User { certificate: Bytes::new(), ..user.clone() };
        assert_eq!(deliver(&mut gate, &bare, &user.set(0, 1, &TWIST)), passes);
    }
}

#[test]
fn a_forged_signature_does_not_pass() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let forger = User { key: network.farhad.key.clone(), ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &network.salma, &forger.set(3, 1, &TWIST)), Err(Refused::BadSignature));
    let mut changed = network.salma.set(3, 1, &TWIST).encoded().to_vec();
    let place = changed.windows(9).position(|window| window == b"T/cmd_vel").unwrap();
    changed[place - 20] ^= 1;
    if let Ok(changed) = Transaction::decode(changed.into()) {
        assert!(deliver(&mut gate, &network.salma, &changed).is_err());
    }
    assert_eq!(
        deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)),
        Ok(1),
        "a forgery uses up nothing"
    );
}

#[test]
fn a_transaction_for_another_network_does_not_pass() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let elsewhere = User { network: ledger_base::hash::Hash([9; 32]), ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &elsewhere, &elsewhere.set(3, 1, &TWIST)), Err(Refused::WrongNetwork));
}

#[test]
fn only_set_of_this_very_service_passes() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let args = |service: &'static str| [service, "3", "1"].map(Bytes::from).into_iter().chain(TWIST.iter().cloned());
    for (chaincode, function, service) in [
        ("abac", "set", "Husky/cmd_vel"),
        ("abac", "set", "T"),
        ("abac", "acquire", "T/cmd_vel"),
        ("other", "set", "T/cmd_vel"),
    ] {
        let signed = network.salma.sign(chaincode, function, args(service).collect());
        assert_eq!(deliver(&mut gate, &network.salma, &signed), Err(Refused::WrongCall), "{chaincode} {service}");
    }
    let without_payload = network.salma.sign("abac", "set", args("T/cmd_vel").take(3).collect());
    assert_eq!(deliver(&mut gate, &network.salma, &without_payload), Err(Refused::Malformed));
    for bad in ["+1", "", "x", "18446744073709551616"] {
        let args = ["T/cmd_vel", "3", bad].map(Bytes::from).into_iter().chain(TWIST.iter().cloned()).collect();
        let signed = network.salma.sign("abac", "set", args);
        assert!(deliver(&mut gate, &network.salma, &signed).is_err(), "sequence number {bad:?}");
    }
    let overflow = network.salma.set(3, u64::MAX, &[TWIST[0].clone(), TWIST[0].clone()]);
    assert_eq!(deliver(&mut gate, &network.salma, &overflow), Err(Refused::Malformed));
}

#[test]
fn an_old_epoch_does_not_pass() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(2, 1, &TWIST)), Err(Refused::StaleEpoch));
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(4, 1, &TWIST)), Err(Refused::UnknownEpoch));
}

#[test]
fn nobody_but_the_holder_passes() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(3, 1, &TWIST)), Err(Refused::NotHolder));
    let mut free = network.gate(&service("exclusive"), &[]);
    learn(&mut free, &network, &Service { epoch: 3, ..service("exclusive") }, &[]);
    assert_eq!(deliver(&mut free, &network.salma, &network.salma.set(3, 1, &TWIST)), Err(Refused::NotHolder));
}

/// A service as of a mode that came after this version: several holders, each with a grant.
fn side_by_side() -> Service {
    let capabilities =
        Capabilities { publishing: Publishing::Grant, fencing: Fencing::PerHolder, sequence: Sequence::PerPublisher };
    Service { capabilities, ..service("exclusive") }
}

#[test]
fn holders_side_by_side_pass_under_their_own_epochs_and_nobody_else_does() {
    let network = Network::default();
    let mut gate = network.gate(&side_by_side(), &[grant("Org1/Salma", 3), grant("Org1/Farhad", 4)]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 10, &TWIST)), Ok(1));
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(4, 1, &TWIST)), Ok(1));
    let of_another = network.salma.set(4, 11, &TWIST);
    assert_eq!(deliver(&mut gate, &network.salma, &of_another), Err(Refused::NotHolder));
    let without = network.salma.set(0, 11, &TWIST);
    assert_eq!(deliver(&mut gate, &network.salma, &without), Err(Refused::NotHolder), "a policy alone is not enough");
    let again = network.salma.set(3, 10, &TWIST);
    assert_eq!(
        deliver(&mut gate, &network.salma, &again),
        Err(Refused::StaleSequence),
        "another's message changes nothing"
    );
    learn(&mut gate, &network, &side_by_side(), &[grant("Org1/Salma", 3), grant("Org1/Farhad", 5)]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 11, &TWIST)), Ok(1), "hers goes on");
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(4, 2, &TWIST)), Err(Refused::NotHolder));
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(5, 1, &TWIST)), Err(Refused::StaleSequence));
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(5, 2, &TWIST)), Ok(1));
}

#[test]
fn a_replay_does_not_pass() {
    let network = Network::default();
    for mode in ["exclusive", "open"] {
        let mut gate = network.gate(&service(mode), &[grant("Org1/Salma", 3)]);
        let signed = network.salma.set(3, 7, &TWIST);
        assert_eq!(deliver(&mut gate, &network.salma, &signed), Ok(1));
        assert_eq!(deliver(&mut gate, &network.salma, &signed), Err(Refused::StaleSequence), "{mode}");
    }
}

#[test]
fn the_order_cannot_be_changed() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let (first, second) =
        (network.salma.set(3, 7, &[TWIST[0].clone(), TWIST[0].clone()]), network.salma.set(3, 9, &TWIST));
    assert_eq!(deliver(&mut gate, &network.salma, &second), Ok(1));
    assert_eq!(deliver(&mut gate, &network.salma, &first), Err(Refused::StaleSequence));
    let overlapping = network.salma.set(3, 9, &TWIST);
    assert_eq!(deliver(&mut gate, &network.salma, &overlapping), Err(Refused::StaleSequence));
}

#[test]
fn in_open_mode_every_publisher_has_its_own_numbers() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 100, &TWIST)), Ok(1));
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(0, 1, &TWIST)), Ok(1));
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 100, &TWIST)), Err(Refused::StaleSequence));
    assert_eq!(
        deliver(&mut gate, &network.salma, &network.salma.set(5, 101, &TWIST)),
        Err(Refused::UnknownEpoch),
        "who names an epoch must hold it"
    );
}

#[test]
fn what_is_too_old_does_not_pass() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let signed = network.salma.set(3, 1, &TWIST);
    assert_eq!(deliver_at(&mut gate, &network.salma, &signed, NOW - SECOND - 1), Err(Refused::TooOld));
    assert_eq!(deliver_at(&mut gate, &network.salma, &signed, NOW - SECOND), Ok(1));
}

#[test]
fn the_route_may_shorten_the_age_and_not_extend_it() {
    let network = Network::default();
    for (own_ms, age, passes) in [(500, 501_000, false), (500, 499_000, true), (5000, SECOND + 1, false)] {
        let mut gate = network.gate_with(&service("exclusive"), &[grant("Org1/Salma", 3)], Some(own_ms));
        let passed = deliver_at(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST), NOW - age);
        assert_eq!(passed.is_ok(), passes, "{own_ms} ms, {age} µs");
    }
}

#[test]
fn a_node_cannot_make_an_old_command_young() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let held_back = network.salma.set(3, 1, &TWIST);
    let later = now_at(NOW + 3 * SECOND);
    gate.learn(&service("exclusive"), &network.standing(2, &[grant("Org1/Salma", 3)]), later.steady, later);
    // Three seconds later the node says that the block is of now; but the signer allowed two.
    let delivered = Delivered {
        block_time: NOW + 3 * SECOND,
        transaction: held_back.encoded(),
        certificate: &network.salma.certificate,
    };
    assert_eq!(gate.pass(delivered, later), Err(Refused::Expired));
}

#[test]
fn a_signer_cannot_allow_more_than_the_ledger_does() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let eternal = User { not_after: u64::MAX, ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &network.salma, &eternal.set(3, 1, &TWIST)), Err(Refused::Expired));
}

#[test]
fn block_time_ahead_of_the_clock_only_shortens() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let far = User { not_after: NOW + 60 * SECOND, ..network.salma.clone() };
    assert_eq!(deliver_at(&mut gate, &far, &far.set(3, 1, &TWIST), NOW + 4 * SECOND), Ok(1));
    // The gate knows now that it is later than its own clock says.
    let aged = deliver_at(&mut gate, &far, &far.set(3, 2, &TWIST), NOW + 2 * SECOND);
    assert_eq!(aged, Err(Refused::TooOld));
    let future = deliver_at(&mut gate, &far, &far.set(3, 2, &TWIST), NOW + 6 * SECOND);
    assert_eq!(future, Err(Refused::FromFuture), "so far ahead one of the clocks is wrong");
}

#[test]
fn what_was_signed_before_the_gate_was_opened_does_not_pass() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    let before = User { not_after: network.salma.not_after - 1, ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &before, &before.set(3, 1, &TWIST)), Err(Refused::BeforeStop));
}

#[test]
fn what_was_on_its_way_when_the_robot_was_stopped_does_not_pass() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Ok(1));
    let stop = now_at(NOW + SECOND);
    gate.stopped(stop);
    assert!(!gate.is_moving());
    let on_its_way = network.salma.set(3, 2, &TWIST);
    let late = |block_time, transaction: &Transaction, gate: &mut Gate| {
        let certificate = &network.salma.certificate;
        gate.pass(Delivered { block_time, transaction: transaction.encoded(), certificate }, stop).map(drop)
    };
    assert_eq!(late(NOW + SECOND / 2, &on_its_way, &mut gate), Err(Refused::BeforeStop));
    assert_eq!(late(NOW + SECOND, &on_its_way, &mut gate), Err(Refused::BeforeStop), "whatever the block says");
    let after = User { not_after: NOW + 3 * SECOND, ..network.salma.clone() };
    assert_eq!(late(NOW + SECOND, &after.set(3, 2, &TWIST), &mut gate), Ok(()));
}

#[test]
fn a_signer_who_allows_much_time_does_not_get_past_a_stop_either() {
    let network = Network::default();
    let patient = User { not_after: NOW + 30 * SECOND, ..network.salma.clone() };
    let mut gate = network.gate(&service("open"), &[]);
    gate.stopped(now());
    assert_eq!(deliver_at(&mut gate, &patient, &patient.set(0, 1, &TWIST), NOW - 1), Err(Refused::BeforeStop));
    assert_eq!(deliver_at(&mut gate, &patient, &patient.set(0, 1, &TWIST), NOW), Ok(1));
    let mut gate = network.gate(&service("open"), &[]);
    assert!(gate.released(&released("Org1/Farhad", 3), NOW, now()), "in open mode every release stops the robot");
    assert_eq!(deliver_at(&mut gate, &patient, &patient.set(0, 1, &TWIST), NOW - 1), Err(Refused::BeforeStop));
    assert_eq!(deliver_at(&mut gate, &patient, &patient.set(0, 1, &TWIST), NOW), Ok(1));
}

#[test]
fn the_end_of_a_grant_stops_the_robot_and_its_holder() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Ok(1));
    assert!(gate.released(&released("Org1/Salma", 3), NOW, now()));
    assert!(!gate.is_moving());
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 2, &TWIST)), Err(Refused::NotHolder));
    assert!(!gate.released(&Released { service: "Husky/cmd_vel".into(), ..released("Org1/Salma", 3) }, NOW, now()));
}

#[test]
fn the_end_of_an_older_grant_does_not_stop_the_next_holder() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Farhad", 4)]);
    assert!(!gate.released(&released("Org1/Salma", 3), NOW, now()));
    assert!(!gate.released(&released("Org1/Farhad", 3), NOW, now()));
    assert_eq!(deliver(&mut gate, &network.farhad, &network.farhad.set(4, 1, &TWIST)), Ok(1));
}

#[test]
fn a_command_grows_old_from_its_signature_on() {
    let network = Network::default();
    let mut gate = network.gate_with(&service("exclusive"), &[grant("Org1/Salma", 3)], Some(300));
    // Bridges sign for two seconds. This one took 301 ms to its block.
    gate.signed_since = Bound::default();
    let slow = User { not_after: NOW + 2 * SECOND - 301_000, ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &slow, &slow.set(3, 1, &TWIST)), Err(Refused::TooOld));
    let quick = User { not_after: NOW + 2 * SECOND - 300_000, ..network.salma.clone() };
    assert_eq!(deliver(&mut gate, &quick, &quick.set(3, 1, &TWIST)), Ok(1));
}

#[test]
fn the_robot_has_to_stop_when_its_drivers_lease_has_run_out() {
    let network = Network::default();
    let mut gate = network.gate(&service("exclusive"), &[grant("Org1/Salma", 3)]);
    assert_eq!(gate.deadline(), None, "nobody moves it");
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(3, 1, &TWIST)), Ok(1));
    let first = now().steady + 4 * SECOND;
    assert_eq!(gate.deadline(), Some(first));
    let renewed = [Grant { expires: NOW + 9 * SECOND, ..grant("Org1/Salma", 3) }];
    assert_eq!(learn(&mut gate, &network, &service("exclusive"), &renewed), None);
    assert_eq!(gate.deadline(), Some(now().steady + 9 * SECOND), "she has renewed it");
    let shorter = [Grant { expires: NOW + SECOND, ..grant("Org1/Salma", 3) }];
    assert_eq!(learn(&mut gate, &network, &service("exclusive"), &shorter), None);
    assert_eq!(gate.deadline(), Some(now().steady + 9 * SECOND), "an answer takes nothing back");
    gate.stopped(now());
    assert_eq!(gate.deadline(), None);
}

#[test]
fn without_grants_the_lease_of_the_service_counts() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &TWIST)), Ok(1));
    assert_eq!(gate.deadline(), Some(now().steady + 10 * SECOND));
}

#[test]
fn the_revoked_do_not_pass_and_the_robot_they_moved_stops() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &TWIST)), Ok(1));
    assert!(!gate.revoked(&network.farhad.revocation(&network), now()));
    assert!(gate.is_moving());
    assert!(gate.revoked(&network.salma.revocation(&network), now()));
    assert!(!gate.is_moving());
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 2, &TWIST)), Err(Refused::Revoked));
    assert!(!gate.revoked(&Revoked { issuer: ledger_base::hash::Hash::ZERO, serial: "zz".into() }, now()));
}

#[test]
fn a_foreign_authority_vouches_for_nobody() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    let foreign = Network::default();
    let user = User { network: network.salma.network, ..foreign.salma.clone() };
    assert_eq!(deliver(&mut gate, &user, &user.set(0, 1, &TWIST)), Err(Refused::Untrusted));
}

#[test]
fn a_certificate_that_is_not_the_creators_is_no_help() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    let signed = network.salma.set(0, 1, &TWIST);
    assert_eq!(deliver(&mut gate, &network.farhad, &signed), Err(Refused::UnknownCreator));
}

#[test]
fn an_expired_certificate_does_not_pass() {
    let network = Network::default();
    let year = 400 * 24 * 3600 * SECOND;
    let late = NOW + year;
    let mut gate = network.gate(&service("open"), &[]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &TWIST)), Ok(1));
    gate.learn(&service("open"), &network.standing(2, &[]), now_at(late).steady, now_at(late));
    let user = User { not_after: late + 2 * SECOND, ..network.salma.clone() };
    let signed = user.set(0, 2, &TWIST);
    let delivered = Delivered { block_time: late, transaction: signed.encoded(), certificate: &user.certificate };
    assert_eq!(gate.pass(delivered, now_at(late)), Err(Refused::Untrusted), "also when it was verified before");
}

#[test]
fn only_the_owner_feeds_a_feed() {
    let network = Network::default();
    let feed = Service { direction: Direction::Feed, ..service("open") };
    let mut gate = network.gate(&feed, &[]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &TWIST)), Err(Refused::NotOwner));
    assert_eq!(deliver(&mut gate, &network.robot, &network.robot.set(0, 1, &TWIST)), Ok(1));
    assert!(!gate.is_moving(), "a feed moves nothing");
}

#[test]
fn payloads_have_a_limit_and_are_cdr() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    let large = [Bytes::from(vec![0; 1025])];
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &large)), Err(Refused::TooLarge));
    for bad in [&b"\0\x01"[..], b"\xff\xff\0\0", b""] {
        let payload = [TWIST[0].clone(), Bytes::copy_from_slice(bad)];
        assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &payload)), Err(Refused::BadPayload));
    }
}

#[test]
fn nothing_passes_while_the_service_is_not_known() {
    let network = Network::default();
    let mut gate = network.gate(&service("open"), &[]);
    gate.close();
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &TWIST)), Err(Refused::NoService));
    learn(&mut gate, &network, &service("open"), &[]);
    assert_eq!(deliver(&mut gate, &network.salma, &network.salma.set(0, 1, &TWIST)), Ok(1));
}

#[test]
fn holders_are_limited() {
    let network = Network::default();
    let grants: Vec<_> = (0..2 * HOLDERS_MAX as u64).map(|number| grant(&format!("Org1/{number}"), number)).collect();
    let gate = network.gate(&service("open"), &grants);
    assert!(gate.holders.len() <= HOLDERS_MAX);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn truncated_and_damaged_transactions_never_pass(cut in 0usize..400, flip in 0usize..400, bit in 0u8..8) {
        let network = crate::fixture::shared();
        let mut gate = network.gate(&service("open"), &[]);
        let mut bytes = network.salma.set(0, 1, &TWIST).encoded().to_vec();
        let whole = bytes.clone();
        bytes.truncate(bytes.len().saturating_sub(cut));
        if let Some(byte) = bytes.get_mut(flip) {
            *byte ^= 1 << bit;
        }
        prop_assume!(bytes != whole);
        let transaction = Bytes::from(bytes);
        let delivered = Delivered { block_time: NOW, transaction: &transaction, certificate: &network.salma.certificate };
        prop_assert!(gate.pass(delivered, now()).is_err());
    }

    #[test]
    fn arbitrary_bytes_never_panic(transaction: Vec<u8>, certificate: Vec<u8>, block_time: u64) {
        let network = crate::fixture::shared();
        let mut gate = network.gate(&service("open"), &[]);
        let (transaction, certificate) = (Bytes::from(transaction), Bytes::from(certificate));
        let delivered = Delivered { block_time, transaction: &transaction, certificate: &certificate };
        prop_assert!(gate.pass(delivered, now()).is_err());
    }
}
