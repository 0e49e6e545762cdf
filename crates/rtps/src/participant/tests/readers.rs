//! Rules of readers and writers of applications: what they get, and what they never get.

use super::by_hand::*;
use super::network::Network;
use super::node::Reception;
use crate::guid::{EntityId, Guid};
use crate::interface::{EndpointSettings, Input, Output};
use crate::qos::{Durability, History, Qos};
use crate::wire::submessage::{InlineQos, Payload};
use bytes::Bytes;

fn reception(network: &mut Network, slot: usize, reader: EntityId, writer: Guid) -> Reception {
    network.node(slot).matches[&(reader, writer)].clone()
}

#[test]
fn an_endpoint_is_found_with_the_user_data_that_it_was_opened_with() {
    let mut network = network(2);
    let user_data = Bytes::from_static(b"typehash=RIHS01_0123456789abcdef;");
    let named = |name| EndpointSettings { user_data: user_data.clone(), ..settings(name, Qos::default()) };
    network.open(0, named("rt/t"), true);
    network.open(0, named("rt/t"), false);
    network.run(LEASE);
    let participant = &network.node(1).participant;
    let found: Vec<_> = participant.publishers().chain(participant.subscribers()).collect();
    assert_eq!(found.len(), 2);
    assert!(found.iter().all(|endpoint| endpoint.user_data == user_data));
}

#[test]
fn a_sample_that_is_written_as_soon_as_its_writer_is_open_is_sent() {
    let mut network = network(2);
    let reader = network.open(1, settings("rt/t", reliable(Durability::TransientLocal)), false);
    network.run(LEASE);
    let writer = network.open(0, settings("rt/t", reliable(Durability::TransientLocal)), true);
    network.write(0, writer);
    network.run(LEASE);
    let guid = network.node(0).guid(writer);
    assert_eq!(reception(&mut network, 1, reader, guid).last, 1);
}

#[test]
fn a_sample_in_the_name_of_a_writer_of_discovery_reaches_no_reader_of_an_application() {
    let mut participant = alone();
    let opened = step(&mut participant, 0, Input::OpenReader(settings("rt/t", Qos::default())));
    let Some(Output::Opened(reader)) = opened.first().cloned() else { panic!() };
    step(&mut participant, 0, datagram(STRANGER, &[announced(&participant_data(STRANGER))]));
    let writers = [
        EntityId::SPDP_WRITER,
        EntityId::PUBLICATIONS_WRITER,
        EntityId::SUBSCRIPTIONS_WRITER,
        EntityId::LIVELINESS_WRITER,
        EntityId::UNKNOWN,
        EntityId::PARTICIPANT,
        EntityId::writer(1, false),
    ];
    for (sequence, writer) in (1..).zip(writers) {
        for to in [reader, EntityId::UNKNOWN] {
            let mut sample = data(writer, sequence, Payload::Data(Bytes::from_static(b"data")), InlineQos::default());
            if let crate::wire::submessage::Submessage::Data(data) = &mut sample {
                data.reader = to;
            }
            let out = step(&mut participant, 1, datagram(STRANGER, &[sample]));
            assert!(!out.iter().any(|output| matches!(output, Output::Sample { .. })), "{writer:?} {to:?}");
        }
    }
}

#[test]
fn a_volatile_reader_gets_nothing_that_other_readers_of_its_participant_got_before() {
    for durability in [Durability::Volatile, Durability::TransientLocal] {
        let mut network = network(2);
        let qos = Qos { history: History::KeepLast(10), ..reliable(durability) };
        let writer = network.open(0, settings("rt/t", qos), true);
        let first = network.open(1, settings("rt/t", reliable(Durability::Volatile)), false);
        network.run(LEASE);
        for _ in 0..3 {
            network.write(0, writer);
        }
        network.run(LEASE);
        let second = network.open(1, settings("rt/t", reliable(Durability::Volatile)), false);
        network.run(LEASE);
        network.write(0, writer);
        network.run(LEASE);
        let guid = network.node(0).guid(writer);
        let [first, second] = [first, second].map(|reader| reception(&mut network, 1, reader, guid));
        assert_eq!((first.samples, second.samples, second.first), (4, 1, 4));
        assert!(second.lost.is_empty());
    }
}

#[test]
fn a_latched_reader_gets_nothing_of_a_writer_that_has_gone() {
    let mut network = network(2);
    let latched = || settings("rt/t", reliable(Durability::TransientLocal));
    let writer = network.open(0, latched(), true);
    let first = network.open(1, latched(), false);
    network.write(0, writer);
    network.run(LEASE);
    let guid = network.node(0).guid(writer);
    assert_eq!(reception(&mut network, 1, first, guid).samples, 1);
    network.close(1, first);
    network.close(0, writer);
    network.run(LEASE);
    let late = network.open(1, latched(), false);
    network.run(LEASE);
    // A sample of a writer that does not match would fail the test in `Node`.
    assert!(network.node(1).matches.keys().all(|(reader, _)| *reader != late) && network.node(1).found.is_empty());
}

#[test]
fn readers_go_on_when_the_clock_of_their_host_or_of_the_writer_is_set_back_or_forward() {
    let mut network = network(2);
    let writer = network.open(0, settings("rt/t", reliable(Durability::Volatile)), true);
    let readers = [Qos::default(), reliable(Durability::Volatile)];
    let readers = readers.map(|qos| network.open(1, settings("rt/t", qos), false));
    network.run(LEASE);
    let guid = network.node(0).guid(writer);
    for (round, wall) in (1_u64..).zip([1_000_000_000_000_000_000, 0, 1_000_000, 1_700_000_000_000_000]) {
        for slot in 0..2 {
            network.node(slot).wall = wall;
            network.write(0, writer);
            network.run(3 * LEASE);
        }
        for reader in readers {
            let reception = reception(&mut network, 1, reader, guid);
            assert_eq!((reception.samples, reception.last), (2 * round, 2 * round.cast_signed()));
        }
    }
    assert_eq!((network.node(0).gone, network.node(1).gone), (0, 0));
}
