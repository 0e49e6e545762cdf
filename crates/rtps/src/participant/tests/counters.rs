//! Counters of a participant, and the limits of its memory.

use super::by_hand::*;
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::interface::{Channel, Counters, EndpointSettings, Input, OutgoingSample, Output, WriterLosses};
use crate::limits::{ANNOUNCEMENTS_BYTES_MAX, HISTORY_BYTES_MAX, PARTICIPANT_BYTES_MAX, PARTICIPANTS_MAX};
use crate::qos::{Durability, History, Qos};
use crate::wire::submessage::{DataFrag, Heartbeat, InlineQos, Payload, Submessage};
use bytes::Bytes;

fn raw(channel: Channel, bytes: &[u8]) -> Input {
    Input::Datagram { from: FROM, channel, bytes: Bytes::copy_from_slice(bytes) }
}

fn bytes_of(input: &Input) -> Vec<u8> {
    let Input::Datagram { bytes, .. } = input else { panic!() };
    bytes.to_vec()
}

#[test]
fn malformed_datagrams_are_counted_and_well_formed_ones_are_not() {
    let mut participant = alone();
    let hello = bytes_of(&datagram(STRANGER, &[announced(&participant_data(STRANGER))]));
    let own = bytes_of(&datagram(participant.guid().prefix, &[]));
    step(&mut participant, 0, raw(Channel::DiscoveryUnicast, &hello));
    step(&mut participant, 0, raw(Channel::DiscoveryMulticast, &own));
    assert_eq!(participant.counters(), Counters::default());
    let mut other_protocol = hello.clone();
    other_protocol[0] = b'X';
    let mut too_long = hello.clone();
    let length = hello.len() - 10;
    too_long.truncate(length);
    for (number, bytes) in (1..).zip([&b"not RTPS"[..], &[], &other_protocol, &too_long]) {
        step(&mut participant, 0, raw(Channel::DataUnicast, bytes));
        assert_eq!(participant.counters(), Counters { malformed: number, ..Counters::default() });
    }
}

#[test]
fn announcements_that_are_rejected_or_beyond_the_limits_are_counted() {
    let mut participant = alone();
    let (known, other) = (GuidPrefix([1; 12]), GuidPrefix([2; 12]));
    let hello = |prefix| announced(&participant_data(prefix));
    let foreign = published(1, &endpoint_data(writer_of(other, 1)));
    let garbage =
        data(EntityId::PUBLICATIONS_WRITER, 2, Payload::Data(Bytes::from_static(b"????")), InlineQos::default());
    step(&mut participant, 0, datagram(known, &[hello(known), foreign, garbage, hello(other)]));
    assert_eq!(participant.counters().announcements_rejected, 3);
    let partitions = vec!["p".repeat(250); 20];
    let large = crate::announcement::EndpointData {
        qos: Qos { partitions, ..Qos::default() },
        ..endpoint_data(writer_of(known, 3))
    };
    step(&mut participant, 0, datagram(known, &[published(3, &large)]));
    for number in 0..PARTICIPANTS_MAX {
        let [high, low] = u16::try_from(number).unwrap().to_be_bytes();
        let prefix = GuidPrefix([0xee, high, low, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        step(&mut participant, 0, datagram(prefix, &[hello(prefix)]));
    }
    let expected = Counters { announcements_rejected: 3, beyond_limits: 2, ..Counters::default() };
    assert_eq!(participant.counters(), expected);
}

#[test]
fn samples_of_writers_that_no_reader_matches_are_counted_if_they_were_sent_to_this_participant() {
    let mut participant = alone();
    step(&mut participant, 0, Input::OpenReader(settings("rt/t", Qos::default())));
    step(&mut participant, 0, datagram(STRANGER, &[announced(&participant_data(STRANGER))]));
    let sample = |number| {
        data(EntityId::writer(1, false), number, Payload::Data(Bytes::from_static(b"data")), InlineQos::default())
    };
    let bytes = bytes_of(&datagram(STRANGER, &[sample(1)]));
    step(&mut participant, 1, raw(Channel::DataMulticast, &bytes));
    assert_eq!(participant.counters().unknown_writers, 0, "it may be for others");
    let out = step(&mut participant, 1, raw(Channel::DataUnicast, &bytes));
    assert!(!out.iter().any(|output| matches!(output, Output::Sample { .. })));
    assert_eq!(participant.counters().unknown_writers, 1);
    step(&mut participant, 2, datagram(STRANGER, &[published(1, &endpoint_data(writer_of(STRANGER, 1)))]));
    let out = step(&mut participant, 3, datagram(STRANGER, &[sample(2)]));
    assert!(out.iter().any(|output| matches!(output, Output::Sample { .. })));
    assert_eq!(participant.counters().unknown_writers, 1);
}

/// A fragment of a sample that is never whole.
fn part(writer: EntityId, sequence: i64, first: u32, bytes: usize) -> Submessage {
    Submessage::DataFrag(DataFrag {
        reader: EntityId::UNKNOWN,
        writer,
        sequence: SequenceNumber(sequence),
        first,
        count: 1,
        fragment_bytes: u16::try_from(bytes).unwrap(),
        sample_bytes: 16 << 20,
        inline_qos: InlineQos::default(),
        is_key: false,
        payload: vec![7; bytes].into(),
    })
}

#[test]
fn all_readers_together_keep_the_limit_of_the_participant_and_the_bytes_are_free_when_they_close() {
    let mut participant = alone();
    let mut readers = Vec::new();
    let mut hello = vec![announced(&participant_data(STRANGER))];
    for key in 1..=6 {
        let topic = format!("rt/{key}");
        let out = step(&mut participant, 0, Input::OpenReader(settings(&topic, reliable(Durability::Volatile))));
        readers.extend(out.iter().find_map(|output| match output {
            Output::Opened(entity) => Some(*entity),
            _ => None,
        }));
        let mut endpoint = endpoint_data(writer_of(STRANGER, key));
        (endpoint.topic.name, endpoint.qos) = (topic, reliable(Durability::Volatile));
        hello.push(published(key.into(), &endpoint));
    }
    step(&mut participant, 0, datagram(STRANGER, &hello));
    let mut most = 0;
    for sequence in 1..=2 {
        for first in 2..=270 {
            for key in 1..=6 {
                let flood = [part(EntityId::writer(key, false), sequence, first, 60_000)];
                step(&mut participant, 1, datagram(STRANGER, &flood));
                assert!(participant.held_bytes() <= PARTICIPANT_BYTES_MAX);
                most = most.max(participant.held_bytes());
            }
        }
    }
    assert!(most > PARTICIPANT_BYTES_MAX / 10 * 9, "{most}");
    // A writer that goes, a reader that closes, a participant that leaves.
    let closed = disposed(EntityId::PUBLICATIONS_WRITER, 7, writer_of(STRANGER, 6));
    step(&mut participant, 2, datagram(STRANGER, &[closed]));
    readers.into_iter().take(2).for_each(|reader| drop(step(&mut participant, 2, Input::Close(reader))));
    assert!((1..most).contains(&participant.held_bytes()));
    let end = disposed(EntityId::SPDP_WRITER, 9, Guid::new(STRANGER, EntityId::PARTICIPANT));
    step(&mut participant, 2, datagram(STRANGER, &[end]));
    assert_eq!(participant.held_bytes(), 0);
}

#[test]
fn announcements_that_wait_keep_a_limit_of_all_participants_together() {
    let mut participant = alone();
    for number in 0..300_u16 {
        let [high, low] = number.to_be_bytes();
        let prefix = GuidPrefix([0xee, high, low, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        step(&mut participant, 0, datagram(prefix, &[announced(&participant_data(prefix))]));
        for sequence in 2..5 {
            let waits = data(
                EntityId::PUBLICATIONS_WRITER,
                sequence,
                Payload::Data(vec![0; 40_000].into()),
                InlineQos::default(),
            );
            let mut builder = crate::wire::write::DatagramBuilder::new(prefix);
            builder.push(&waits);
            step(&mut participant, 0, raw(Channel::DiscoveryUnicast, &builder.finish()));
            assert!(participant.held_bytes() <= ANNOUNCEMENTS_BYTES_MAX);
        }
    }
    assert!(participant.held_bytes() > ANNOUNCEMENTS_BYTES_MAX / 10 * 9);
}

fn write(participant: &mut crate::Participant, writer: EntityId, bytes: usize) {
    let sample = OutgoingSample { payload: vec![0; bytes].into(), timestamp: None, related: None };
    step(participant, 10, Input::Write { writer, sample });
}

#[test]
fn samples_that_leave_the_history_before_a_reliable_reader_has_them_are_counted_by_their_reason() {
    let sizes = [
        (History::KeepLast(3), 100),
        (History::KeepAll, HISTORY_BYTES_MAX / 3),
        (History::KeepLast(9), HISTORY_BYTES_MAX / 3),
    ];
    let expected = [(7, 0), (0, 8), (0, 8)];
    for ((history, bytes), (replaced, pushed_out)) in sizes.into_iter().zip(expected) {
        for is_reader_reliable in [true, false] {
            let mut participant = alone();
            let qos = Qos { history, ..reliable(Durability::Volatile) };
            let writer = step(
                &mut participant,
                0,
                Input::OpenWriter(EndpointSettings { qos, ..settings("rt/t", Qos::default()) }),
            );
            let Some(Output::Opened(writer)) = writer.first().cloned() else { panic!() };
            let reader = Guid::new(STRANGER, EntityId::reader(1, false));
            let mut endpoint = endpoint_data(reader);
            endpoint.qos = if is_reader_reliable { reliable(Durability::Volatile) } else { Qos::default() };
            let announcement =
                data(EntityId::SUBSCRIPTIONS_WRITER, 1, Payload::Data(endpoint.to_payload()), InlineQos::default());
            let ready = Submessage::Heartbeat(Heartbeat {
                reader: EntityId::UNKNOWN,
                writer: EntityId::SUBSCRIPTIONS_WRITER,
                first: SequenceNumber(1),
                last: SequenceNumber(1),
                count: 1,
                is_final: true,
                is_alive: false,
            });
            let hello = [announced(&participant_data(STRANGER)), announcement, ready];
            let out = step(&mut participant, 0, datagram(STRANGER, &hello));
            assert!(out.iter().any(|output| matches!(output, Output::Matched { .. })));
            for _ in 0..10 {
                write(&mut participant, writer, bytes);
                // A best-effort reader has what was sent.
                while !is_reader_reliable && !participant.is_acknowledged(writer) {
                    let due = participant.deadline().unwrap();
                    step(&mut participant, due, Input::Time);
                }
            }
            let expected = WriterLosses { replaced, pushed_out };
            let expected = if is_reader_reliable { expected } else { WriterLosses::default() };
            assert_eq!(participant.writer_losses(writer), Some(expected), "{history:?}");
        }
    }
}
