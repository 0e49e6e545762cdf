//! Rules of endpoints: announcements and matches. One in each test.

use super::by_hand::*;
use super::network::Weather;
use crate::announcement::{EndpointData, ParticipantData};
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::interface::{EndpointSettings, Input, Output};
use crate::limits::{ENDPOINTS_MAX, ENDPOINTS_OF_PARTICIPANT_MAX};
use crate::qos::{Durability, LivelinessKind, Policy, Qos};
use crate::time::Ticks;
use crate::wire::submessage::{DataFrag, InlineQos, Submessage};
use bytes::Bytes;
use std::collections::BTreeSet;

#[test]
fn a_stranger_that_announces_endpoints_endlessly_takes_no_more_than_its_places() {
    let mut participant = alone();
    step(&mut participant, 0, Input::Time);
    for stranger in 0..6 {
        let prefix = GuidPrefix([stranger + 1; 12]);
        step(&mut participant, 1, datagram(prefix, &[announced(&participant_data(prefix))]));
        for from in (1..=5000).step_by(50) {
            let endpoint = |key: u32| published(i64::from(key), &endpoint_data(writer_of(prefix, key)));
            step(&mut participant, 2, datagram(prefix, &(from..from + 50).map(endpoint).collect::<Vec<_>>()));
        }
        let all = (usize::from(stranger) + 1) * ENDPOINTS_OF_PARTICIPANT_MAX;
        assert_eq!(participant.publishers().count(), all.min(ENDPOINTS_MAX));
    }
    // What ends makes room.
    let prefix = GuidPrefix([1; 12]);
    let out = step(
        &mut participant,
        3,
        datagram(prefix, &[disposed(EntityId::SPDP_WRITER, 9, Guid::new(prefix, EntityId::PARTICIPANT))]),
    );
    assert_eq!(gone(&out).len(), ENDPOINTS_OF_PARTICIPANT_MAX);
    let prefix = GuidPrefix([77; 12]);
    let hello = [announced(&participant_data(prefix)), published(1, &endpoint_data(writer_of(prefix, 1)))];
    assert_eq!(found(&step(&mut participant, 4, datagram(prefix, &hello))), [writer_of(prefix, 1)]);
}

#[test]
fn an_endpoint_counts_only_if_its_own_participant_announces_it() {
    let mut participant = alone();
    let (known, other) = (GuidPrefix([1; 12]), GuidPrefix([2; 12]));
    for prefix in [known, other] {
        step(&mut participant, 0, datagram(prefix, &[announced(&participant_data(prefix))]));
    }
    let foreign = published(1, &endpoint_data(writer_of(known, 1)));
    assert_eq!(found(&step(&mut participant, 1, datagram(other, std::slice::from_ref(&foreign)))), []);
    assert_eq!(found(&step(&mut participant, 1, datagram(known, &[foreign]))), [writer_of(known, 1)]);
    // Nor does another one close it, or its participant.
    let closed = disposed(EntityId::PUBLICATIONS_WRITER, 2, writer_of(known, 1));
    let left = disposed(EntityId::SPDP_WRITER, 2, Guid::new(known, EntityId::PARTICIPANT));
    assert_eq!(gone(&step(&mut participant, 2, datagram(other, &[closed.clone(), left.clone()]))), []);
    assert_eq!(gone(&step(&mut participant, 2, datagram(known, &[closed]))), [writer_of(known, 1)]);
    // Readers, builtin endpoints and kinds of vendors are no writers of an application.
    let kinds = [0x04, 0x07, 0xc2, 0x42, 0x08].map(|kind| Guid::new(known, EntityId([0, 0, 9, kind])));
    let others: Vec<Submessage> =
        (3..).zip(kinds).map(|(number, guid)| published(number, &endpoint_data(guid))).collect();
    assert_eq!(found(&step(&mut participant, 3, datagram(known, &others))), []);
}

#[test]
fn a_late_participant_hears_of_all_that_is_open_after_thousands_have_been_closed() {
    let mut network = network(2);
    let kept = network.open(0, settings("rt/kept", Qos::default()), true);
    for number in 0..3000 {
        let entity = network.open(0, settings(&format!("rt/{number}"), Qos::default()), true);
        network.run(20);
        network.close(0, entity);
    }
    network.run(4 * LEASE);
    let guid = network.node(0).guid(kept);
    assert_eq!(network.node(1).found, BTreeSet::from([guid]));
    network.crash(1);
    network.run(2 * LEASE);
    network.start(1);
    network.run(4 * LEASE);
    assert_eq!(network.node(1).found, BTreeSet::from([guid]));
}

#[test]
fn what_was_closed_while_a_participant_stood_still_is_gone_when_it_comes_back() {
    let mut network = network(2);
    let [kept, closed] = [(); 2].map(|()| network.open(1, settings("rt/t", Qos::default()), true));
    network.run(LEASE / 2);
    network.slots[0].is_stopped = true;
    network.run(3 * LEASE);
    network.close(1, closed);
    network.run(3 * LEASE);
    network.resume(0);
    network.run(LEASE);
    let kept = network.node(1).guid(kept);
    assert_eq!((network.node(0).found.clone(), network.node(0).gone), (BTreeSet::from([kept]), 1));
}

#[test]
fn a_thousand_endpoints_are_found_over_a_bad_network() {
    let mut network = network(2);
    network.weather = Weather { loss: 10, twice: 5, delay: 3_000 };
    for number in 0..1000 {
        network.open(0, settings(&format!("rt/{number}"), Qos::default()), number % 2 == 0);
    }
    network.run(10 * LEASE);
    assert_eq!((network.node(1).found.len(), network.node(1).gone), (1000, 0));
}

#[test]
fn topics_with_and_without_keys_match_and_other_types_do_not() {
    let mut network = network(2);
    let keyed = EndpointSettings { topic: topic("rt/t", true), ..settings("rt/t", Qos::default()) };
    let mut other_type = settings("rt/t", Qos::default());
    other_type.topic.type_name = "U".into();
    let writer = network.open(0, keyed, true);
    network.open(0, other_type, true);
    let reader = network.open(1, settings("rt/t", Qos::default()), false);
    network.run(LEASE / 2);
    let (w, r) = (network.node(0).guid(writer), network.node(1).guid(reader));
    assert_eq!(network.node(1).matches.keys().collect::<Vec<_>>(), [&(reader, w)]);
    assert_eq!(network.node(0).matches.keys().collect::<Vec<_>>(), [&(writer, r)]);
}

#[test]
fn what_does_not_fit_is_told_on_both_sides_with_the_policy() {
    let mut network = network(2);
    let writer = network.open(0, settings("rt/t", Qos::default()), true);
    let reader = network.open(1, settings("rt/t", reliable(Durability::Volatile)), false);
    network.run(LEASE);
    let (w, r) = (network.node(0).guid(writer), network.node(1).guid(reader));
    assert_eq!(network.node(0).incompatible, [(writer, r, Policy::Reliability)]);
    assert_eq!(network.node(1).incompatible, [(reader, w, Policy::Reliability)]);
    assert_eq!((network.node(0).matches.len(), network.node(1).matches.len()), (0, 0));
}

#[test]
fn an_endpoint_without_an_address_is_found_and_does_not_match_until_it_has_one() {
    let mut participant = alone();
    let reader = settings("rt/t", Qos::default());
    step(&mut participant, 0, Input::OpenReader(reader));
    let hidden = ParticipantData { data_unicast: Vec::new(), ..participant_data(STRANGER) };
    let hello = [announced(&hidden), published(1, &endpoint_data(writer_of(STRANGER, 1)))];
    let out = step(&mut participant, 1, datagram(STRANGER, &hello));
    assert!(!out.iter().any(|output| matches!(output, Output::Matched { .. })));
    assert_eq!(participant.publishers().map(|writer| writer.is_reachable).collect::<Vec<_>>(), [false]);
    let out = step(&mut participant, 2, datagram(STRANGER, &[announced(&participant_data(STRANGER))]));
    assert!(out.iter().any(|output| matches!(output, Output::Matched { .. })));
    assert_eq!(participant.publishers().map(|writer| writer.is_reachable).collect::<Vec<_>>(), [true]);
}

#[test]
fn the_liveliness_of_writers_with_a_lease_is_asserted_within_it() {
    let mut network = network(2);
    let qos = Qos {
        liveliness: LivelinessKind::Automatic,
        liveliness_lease: Ticks::from_micros(300_000),
        ..reliable(Durability::Volatile)
    };
    network.run(LEASE / 2);
    let before = network.node(0).sent.1;
    network.run(LEASE);
    let without = network.node(0).sent.1 - before;
    let writer = network.open(0, settings("rt/t", qos), true);
    network.run(LEASE);
    let before = network.node(0).sent.1;
    network.run(LEASE);
    let with = network.node(0).sent.1 - before;
    assert!((without + 10..without + 40).contains(&with), "{without} and {with} datagrams in a second");
    network.close(0, writer);
    network.run(LEASE);
    let before = network.node(0).sent.1;
    network.run(LEASE);
    assert_eq!(network.node(0).sent.1 - before, without);
}

#[test]
fn that_all_have_everything_is_said_once_after_each_time_that_something_was_written() {
    let mut network = network(2);
    let writer = network.open(0, settings("rt/t", reliable(Durability::TransientLocal)), true);
    network.write(0, writer);
    assert_eq!(network.node(0).own[&writer].acknowledged, 1, "there are no readers");
    network.open(1, settings("rt/t", reliable(Durability::TransientLocal)), false);
    network.run(LEASE);
    assert_eq!(network.node(0).own[&writer].acknowledged, 2, "a late reader has it as well");
    network.write(0, writer);
    assert!(!network.node(0).participant.is_acknowledged(writer));
    assert!(network.node(0).participant.unacknowledged_bytes(writer) > 0);
    network.run(5 * LEASE);
    assert_eq!(network.node(0).own[&writer].acknowledged, 3);
    // A reader that goes is not waited for.
    network.crash(1);
    network.write(0, writer);
    network.run(2 * LEASE);
    assert_eq!(network.node(0).own[&writer].acknowledged, 4);
}

/// An announcement in fragments, with a parameter of this size that is not understood (type information).
fn in_fragments(sequence: i64, endpoint: &EndpointData, bytes: u16) -> Vec<Submessage> {
    let payload = endpoint.to_payload();
    let mut whole = payload[..4].to_vec();
    for from in (0..bytes).step_by(32_000) {
        let length = (bytes - from).min(32_000);
        whole.extend([0x75, 0x00]);
        whole.extend(length.to_le_bytes());
        whole.resize(whole.len() + usize::from(length), 7);
    }
    whole.extend(&payload[4..]);
    let fragment = |(at, part): (usize, &[u8])| {
        Submessage::DataFrag(DataFrag {
            reader: EntityId::UNKNOWN,
            writer: EntityId::PUBLICATIONS_WRITER,
            sequence: SequenceNumber(sequence),
            first: u32::try_from(at).unwrap() + 1,
            count: 1,
            fragment_bytes: 8_000,
            sample_bytes: u32::try_from(whole.len()).unwrap(),
            inline_qos: InlineQos::default(),
            is_key: false,
            payload: Bytes::copy_from_slice(part),
        })
    };
    whole.chunks(8_000).enumerate().map(fragment).collect()
}

#[test]
fn announcements_in_fragments_are_put_together_and_too_large_ones_are_passed_over() {
    let mut participant = alone();
    step(&mut participant, 0, datagram(STRANGER, &[announced(&participant_data(STRANGER)), heartbeat(3)]));
    let [large, too_large, last] = [1, 2, 3].map(|key| writer_of(STRANGER, key));
    let mut all = Vec::new();
    let fragments = in_fragments(1, &endpoint_data(large), 60_000).into_iter().chain(in_fragments(
        2,
        &endpoint_data(too_large),
        65_532,
    ));
    for fragment in fragments {
        all.extend(found(&step(&mut participant, 1, datagram(STRANGER, &[fragment]))));
    }
    assert_eq!(all, [large]);
    assert_eq!(found(&step(&mut participant, 1, datagram(STRANGER, &[published(3, &endpoint_data(last))]))), [last]);
}

#[test]
fn an_endpoint_with_more_text_than_is_kept_is_ignored() {
    let mut participant = alone();
    let partitions = |count: usize| Qos { partitions: vec!["p".repeat(250); count], ..Qos::default() };
    let [small, large] = [(1, 14), (2, 18)]
        .map(|(key, count)| EndpointData { qos: partitions(count), ..endpoint_data(writer_of(STRANGER, key)) });
    let hello = [announced(&participant_data(STRANGER)), published(1, &small), published(2, &large)];
    assert_eq!(found(&step(&mut participant, 0, datagram(STRANGER, &hello))), [small.guid]);
}
