//! Liveliness and deadlines, over the network of the simulation.

use super::by_hand::*;
use super::network::Network;
use crate::guid::{EntityId, Guid};
use crate::interface::Input;
use crate::qos::{Durability, LivelinessKind, Qos, Reliability};
use crate::time::Ticks;
use crate::wire::read;
use crate::wire::submessage::Submessage;
use std::collections::BTreeMap;

/// The lease of liveliness; participants have a longer one.
const SHORT: u64 = LEASE / 2;

fn qos(liveliness: LivelinessKind) -> Qos {
    Qos { liveliness, liveliness_lease: Ticks::from_micros(SHORT), ..reliable(Durability::Volatile) }
}

/// A writer of slot 0 and a reader of slot 1 that have found each other.
fn pair(liveliness: LivelinessKind) -> (Network, EntityId, EntityId, Guid) {
    let mut network = network(2);
    let writer = network.open(0, settings("rt/t", qos(liveliness)), true);
    let reader = network.open(1, settings("rt/t", Qos { liveliness, ..reliable(Durability::Volatile) }), false);
    network.run(SHORT / 2);
    let guid = network.node(0).guid(writer);
    assert!(network.node(1).matches.contains_key(&(reader, guid)));
    (network, writer, reader, guid)
}

/// Is the writer reported as alive after this time?
fn is_alive_after(network: &mut Network, micros: u64, reader: EntityId, writer: Guid) -> bool {
    network.run(micros);
    assert!(network.node(1).matches.contains_key(&(reader, writer)), "the match does not depend on it");
    !network.node(1).not_alive.contains(&(reader, writer))
}

#[test]
fn an_automatic_writer_is_alive_as_long_as_anything_comes_of_its_participant() {
    let (mut network, _, reader, writer) = pair(LivelinessKind::Automatic);
    assert!(is_alive_after(&mut network, 5 * LEASE, reader, writer));
    // Its process stands still, for less than the lease of the participant.
    network.slots[0].is_stopped = true;
    assert!(!is_alive_after(&mut network, SHORT + LEASE / 10, reader, writer));
    network.resume(0);
    assert!(is_alive_after(&mut network, LEASE / 5, reader, writer));
}

#[test]
fn a_writer_of_kind_manual_by_topic_asserts_itself_by_writing_or_on_request_and_by_no_timer() {
    let (mut network, writer, reader, guid) = pair(LivelinessKind::ManualByTopic);
    for _ in 0..5 {
        network.write(0, writer);
        assert!(is_alive_after(&mut network, SHORT - 10_000, reader, guid));
    }
    assert!(!is_alive_after(&mut network, 3 * SHORT, reader, guid), "nothing was written");
    for _ in 0..5 {
        network.step(0, Input::AssertLiveliness(writer));
        assert!(is_alive_after(&mut network, SHORT - 10_000, reader, guid));
    }
    // Another writer of the participant does not count.
    let other = network.open(0, settings("rt/t", qos(LivelinessKind::ManualByTopic)), true);
    network.run(SHORT / 4);
    network.write(0, other);
    assert!(!is_alive_after(&mut network, SHORT, reader, guid));
    assert_eq!(network.node(1).matches[&(reader, guid)].samples, 5);
}

#[test]
fn a_writer_of_kind_manual_by_participant_is_asserted_by_any_writer_of_the_kind_on_any_topic() {
    let (mut network, writer, reader, guid) = pair(LivelinessKind::ManualByParticipant);
    let elsewhere = network.open(0, settings("rt/elsewhere", qos(LivelinessKind::ManualByParticipant)), true);
    let automatic = network.open(0, settings("rt/elsewhere", qos(LivelinessKind::Automatic)), true);
    for _ in 0..10 {
        network.write(0, elsewhere);
        assert!(is_alive_after(&mut network, SHORT / 2, reader, guid));
    }
    assert!(!is_alive_after(&mut network, 2 * SHORT, reader, guid));
    network.write(0, automatic);
    assert!(!is_alive_after(&mut network, SHORT / 4, reader, guid), "of another kind");
    for assert in [Input::AssertLiveliness(elsewhere), Input::AssertLiveliness(writer)] {
        network.step(0, assert);
        assert!(is_alive_after(&mut network, SHORT / 4, reader, guid));
        assert!(!is_alive_after(&mut network, 2 * SHORT, reader, guid));
    }
}

#[test]
fn a_reader_that_comes_late_is_notified_that_a_writer_is_not_alive() {
    let (mut network, writer, _, guid) = pair(LivelinessKind::ManualByTopic);
    network.run(2 * SHORT);
    let late = network.open(1, settings("rt/t", reliable(Durability::Volatile)), false);
    assert!(!is_alive_after(&mut network, SHORT / 4, late, guid));
    network.write(0, writer);
    assert!(is_alive_after(&mut network, SHORT / 4, late, guid));
}

#[test]
fn a_process_that_stood_still_does_not_report_others_as_not_alive() {
    let (mut network, _, reader, writer) = pair(LivelinessKind::Automatic);
    network.slots[1].is_stopped = true;
    network.run(20 * LEASE);
    let before = network.node(1).steps;
    network.resume(1);
    assert!(network.node(1).steps > before && is_alive_after(&mut network, 1_000, reader, writer));
}

#[test]
fn a_deadline_that_no_sample_keeps_is_reported_by_the_reader() {
    let mut network = network(2);
    let with_deadline = |reliability| Qos { deadline: Ticks::from_micros(100_000), reliability, ..Qos::default() };
    let writer = network.open(0, settings("rt/t", with_deadline(Reliability::Reliable)), true);
    let mut missed = BTreeMap::new();
    for reliability in [Reliability::Reliable, Reliability::BestEffort] {
        let reader = network.open(1, settings("rt/t", with_deadline(reliability)), false);
        missed.insert(reader, 3);
    }
    network.run(LEASE);
    assert!(network.node(1).deadlines_missed.is_empty(), "before the first sample nothing is due");
    for _ in 0..20 {
        network.write(0, writer);
        network.run(90_000);
    }
    assert!(network.node(1).deadlines_missed.is_empty());
    network.run(250_000);
    assert_eq!(network.node(1).deadlines_missed, missed);
    network.close(0, writer);
    network.run(LEASE);
    assert_eq!(network.node(1).deadlines_missed, missed, "there is no writer any more");
}

#[test]
fn an_asserted_writer_sends_a_heartbeat_with_the_flag_of_liveliness_to_all_its_readers() {
    let (mut network, writer, ..) = pair(LivelinessKind::ManualByTopic);
    network.open(1, settings("rt/t", Qos::default()), false);
    network.run(SHORT);
    let now = network.now;
    let sent = network.node(0).step(now, Input::AssertLiveliness(writer));
    let flags = sent.iter().flat_map(|(_, bytes)| read::submessages(bytes)).filter_map(|message| {
        let Submessage::Heartbeat(heartbeat) = message.submessage else { return None };
        Some((heartbeat.reader, heartbeat.writer, heartbeat.is_alive))
    });
    assert_eq!(flags.collect::<Vec<_>>(), [(EntityId::UNKNOWN, writer, true)]);
}

#[test]
fn the_lease_of_a_writer_ends_with_it() {
    let mut participant = alone();
    step(&mut participant, 0, Input::Time);
    let mut endpoint = endpoint_data(writer_of(STRANGER, 1));
    endpoint.qos.liveliness_lease = Ticks::from_micros(150_000);
    step(&mut participant, 0, datagram(STRANGER, &[announced(&participant_data(STRANGER)), published(1, &endpoint)]));
    step(&mut participant, 10_000, datagram(STRANGER, &[disposed(EntityId::PUBLICATIONS_WRITER, 2, endpoint.guid)]));
    while let Some(due) = participant.deadline().filter(|due| *due < LEASE / 5) {
        assert_ne!(due, 150_000);
        step(&mut participant, due, Input::Time);
    }
}
