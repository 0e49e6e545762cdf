#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod properties;

use super::cursor::ByteOrder;
use super::read::submessages;
use super::submessage::{Addressed, Heartbeat, InlineQos, NumberSet, Payload, Submessage};
use super::write::DatagramBuilder;
use crate::guid::{EntityId, GuidPrefix, SampleIdentity, SequenceNumber};
use crate::limits::{DATAGRAM_BYTES_MAX, SUBMESSAGES_MAX};
use crate::time::Ticks;
use bytes::Bytes;

const SOURCE: GuidPrefix = GuidPrefix([7; 12]);
/// Reader 00000104, writer 00000103.
const ENTITIES: [u8; 8] = [0, 0, 1, 4, 0, 0, 1, 3];

/// A datagram with these bytes behind the header.
fn datagram(body: &[&[u8]]) -> Bytes {
    [b"RTPS\x02\x03\x01\x10", &SOURCE.0[..], &body.concat()].concat().into()
}

/// A little-endian submessage.
fn frame(kind: u8, flags: u8, body: &[&[u8]]) -> Vec<u8> {
    let body = body.concat();
    [&[kind, flags | 1], &u16::try_from(body.len()).unwrap().to_le_bytes()[..], &body].concat()
}

fn number(sequence: i64) -> [u8; 8] {
    let number = sequence.cast_unsigned();
    let halves = [u32::try_from(number >> 32).unwrap(), u32::try_from(number & 0xffff_ffff).unwrap()];
    halves.map(u32::to_le_bytes).concat().try_into().unwrap()
}

fn heartbeat_frame(first: i64, last: i64) -> Vec<u8> {
    frame(7, 0, &[&ENTITIES, &number(first), &number(last), &[9, 0, 0, 0]])
}

fn read(datagram: &Bytes) -> Vec<Submessage> {
    submessages(datagram).map(|addressed| addressed.submessage).collect()
}

/// How many submessages are read of one that is followed by a valid HEARTBEAT: 2 if it is valid, 1 if it is skipped, 0 if it ends all.
fn count_with(submessage: &[u8]) -> usize {
    read(&datagram(&[submessage, &heartbeat_frame(1, 1)])).len()
}

#[test]
fn a_big_endian_heartbeat_is_read() {
    let body = [&ENTITIES[..], &[0, 0, 0, 1, 0, 0, 0, 2], &[0, 0, 0, 1, 0, 0, 0, 3], &[0, 0, 0, 9]].concat();
    let expected = Heartbeat {
        reader: EntityId([0, 0, 1, 4]),
        writer: EntityId([0, 0, 1, 3]),
        first: SequenceNumber((1 << 32) + 2),
        last: SequenceNumber((1 << 32) + 3),
        count: 9,
        is_final: true,
        is_alive: true,
    };
    assert_eq!(read(&datagram(&[&[7, 6, 0, 28], &body])), [Submessage::Heartbeat(expected)]);
}

#[test]
fn info_submessages_apply_to_the_submessages_behind_them() {
    let (other, destination) = ([8; 12], [9; 12]);
    let info_source = frame(0x0c, 0, &[&[0, 0, 0, 0], &[2, 5, 1, 0x0f], &other]);
    let time = frame(0x09, 0, &[&[1, 0, 0, 0, 2, 0, 0, 0]]);
    let datagram = datagram(&[
        &heartbeat_frame(1, 1),
        &time,
        &frame(0x0e, 0, &[&destination]),
        &heartbeat_frame(1, 1),
        &frame(0x09, 2, &[]),
        &heartbeat_frame(1, 1),
        &time,
        &frame(0x09, 0, &[&[0xff; 8]]),
        &heartbeat_frame(1, 1),
        &time,
        &info_source,
        &heartbeat_frame(1, 1),
    ]);
    let found: Vec<_> = submessages(&datagram)
        .map(|Addressed { source, destination, timestamp, .. }| (source.0, destination.0, timestamp))
        .collect();
    let at = Some(Ticks((1 << 32) + 2));
    assert_eq!(
        found,
        [
            (SOURCE.0, [0; 12], None),
            (SOURCE.0, destination, at),
            (SOURCE.0, destination, None),
            (SOURCE.0, destination, None),
            (other, destination, None),
        ]
    );
}

#[test]
fn unknown_and_vendor_specific_submessages_padding_and_info_reply_are_skipped() {
    for kind in [0x00, 0x01, 0x0d, 0x0f, 0x1f, 0x7f, 0x80, 0xff] {
        assert_eq!(count_with(&frame(kind, 0, &[&[1, 2, 3, 4]])), 1, "{kind:x}");
    }
    assert_eq!(count_with(&frame(0x01, 0, &[])), 1);
}

#[test]
fn the_last_submessage_may_leave_its_length_open() {
    let mut open = heartbeat_frame(1, 1);
    open[2] = 0;
    assert_eq!(read(&datagram(&[&heartbeat_frame(1, 1), &open])).len(), 2);
    // What follows belongs to it.
    assert_eq!(count_with(&open), 1);
}

#[test]
fn a_length_beyond_the_datagram_and_another_protocol_end_it() {
    let mut long = frame(0x80, 0, &[&[0; 4]]);
    long[2] = 200;
    assert_eq!(count_with(&long), 0);
    let valid = datagram(&[&heartbeat_frame(1, 1)]);
    for (at, byte) in [(0, b'X'), (4, 1), (4, 3)] {
        let mut changed = valid.to_vec();
        changed[at] = byte;
        assert_eq!(read(&changed.into()).len(), 0);
    }
    assert_eq!((0..20).map(|length| read(&valid.slice(..length)).len()).sum::<usize>(), 0);
}

#[test]
fn invalid_heartbeats_end_the_datagram() {
    for (first, last, count) in [
        (1, 0, 2),
        (1, i64::MAX, 2),
        (i64::MAX, i64::MAX, 2),
        (0, 1, 0),
        (-1, 1, 0),
        (5, 3, 0),
        (i64::MIN, i64::MIN, 0),
        (1, -1, 0),
    ] {
        assert_eq!(count_with(&heartbeat_frame(first, last)), count, "{first} {last}");
    }
    let fragment = |sequence, last: u32| frame(0x13, 0, &[&ENTITIES, &number(sequence), &last.to_le_bytes(), &[0; 4]]);
    assert_eq!([fragment(1, 1), fragment(0, 1), fragment(1, 0)].map(|frame| count_with(&frame)), [2, 0, 0]);
}

#[test]
fn invalid_sets_end_the_datagram() {
    let set = |base: &[u8], bits: u32, words: usize| [base, &bits.to_le_bytes(), &vec![0xff; 4 * words]].concat();
    for (base, bits, words, count) in [
        (0, 0, 0, 2),
        (1, 256, 8, 2),
        (1, 33, 2, 2),
        (1, 257, 9, 0),
        (1, u32::MAX, 8, 0),
        (-1, 1, 1, 0),
        (i64::MAX, 1, 1, 2),
        (i64::MAX, 2, 1, 0),
    ] {
        let acknack = frame(0x06, 2, &[&ENTITIES, &set(&number(base), bits, words), &[1, 0, 0, 0]]);
        assert_eq!(count_with(&acknack), count, "{base} {bits}");
        let gap = |start| frame(0x08, 0, &[&ENTITIES, &number(start), &set(&number(base), bits, words)]);
        assert_eq!([count_with(&gap(1)), count_with(&gap(0))], [count, 0], "{base} {bits}");
    }
    // The words are missing, and the submessage ends.
    assert_eq!(count_with(&frame(0x06, 2, &[&ENTITIES, &set(&number(1), 256, 3)])), 0);
    for (base, bits, count) in [(1_u32, 256, 2), (0, 1, 0), (u32::MAX, 1, 2), (u32::MAX, 2, 0)] {
        let set = set(&base.to_le_bytes(), bits, bits.div_ceil(32) as usize);
        let nack = |sequence| frame(0x12, 0, &[&ENTITIES, &number(sequence), &set, &[1, 0, 0, 0]]);
        assert_eq!([count_with(&nack(1)), count_with(&nack(0))], [count, 0], "{base} {bits}");
    }
}

fn data(flags: u8, to_inline_qos: u8, sequence: i64, rest: &[u8]) -> Vec<u8> {
    frame(0x15, flags, &[&[0, 0, to_inline_qos, 0], &ENTITIES, &number(sequence), rest])
}

#[test]
fn data_has_a_valid_number_and_a_sample_or_a_key_but_not_both() {
    for (flags, sequence, count) in
        [(4, 1, 2), (8, 1, 2), (0, 1, 2), (12, 1, 0), (4, 0, 0), (4, -1, 0), (4, -1 << 32, 0)]
    {
        assert_eq!(count_with(&data(flags, 16, sequence, &[])), count, "{flags} {sequence}");
    }
    // In a format that is not of the standard.
    assert_eq!(count_with(&data(0x14, 16, 1, &[1, 2, 3, 4])), 1);
}

#[test]
fn fields_of_later_versions_in_front_of_the_parameters_are_skipped() {
    let [Submessage::Data(read), _] =
        &read(&datagram(&[&data(4, 20, 1, &[9, 9, 9, 9, 5]), &heartbeat_frame(1, 1)]))[..]
    else {
        unreachable!()
    };
    assert_eq!(read.payload, Payload::Data(Bytes::from_static(&[5])));
    assert_eq!(count_with(&data(4, 12, 1, &[5])), 0);
    assert_eq!(count_with(&data(4, 200, 1, &[5])), 0);
}

#[test]
fn parameters_that_are_not_known_are_skipped_and_a_list_without_end_is_invalid() {
    let unknown = [0x34, 0x12, 5, 0, 1, 2, 3, 4, 5, 0, 0, 0];
    let pad = [0, 0, 4, 0, 9, 9, 9, 9];
    let status = [0x71, 0, 4, 0, 0, 0, 0, 3];
    let end = [1, 0, 0, 0];
    let list = [&unknown[..], &pad, &status, &end].concat();
    let all = read(&datagram(&[&data(6, 16, 1, &[&list[..], &[5, 6, 7, 8]].concat())]));
    let [Submessage::Data(read)] = &all[..] else { unreachable!() };
    assert_eq!(read.inline_qos, InlineQos { status: 3, ..InlineQos::default() });
    assert_eq!(read.payload, Payload::Data(Bytes::from_static(&[5, 6, 7, 8])));
    assert_eq!(count_with(&data(2, 16, 1, &status)), 0);
    assert_eq!(count_with(&data(2, 16, 1, &[0x71, 0, 8, 0, 0, 0, 0, 3])), 0);
    assert_eq!(count_with(&data(2, 16, 1, &[pad.repeat(512), end.to_vec()].concat())), 0);
}

#[test]
fn the_number_of_the_standard_counts_before_that_of_fast_dds() {
    let identity = |id: u16, sequence| [&id.to_le_bytes()[..], &[24, 0], &[1; 16], &number(sequence)].concat();
    for (list, sequence) in [
        ([identity(0x0083, 5), identity(0x800f, 6)].concat(), Some(5)),
        ([identity(0x800f, 6), identity(0x0083, 5)].concat(), Some(5)),
        (identity(0x800f, 6), Some(6)),
        // A parameter of another vendor with the same number.
        ([0x0f, 0x80, 4, 0, 1, 2, 3, 4].to_vec(), None),
    ] {
        let list = [&list[..], &[1, 0, 0, 0]].concat();
        let all = read(&datagram(&[&data(2, 16, 1, &list)]));
        let [Submessage::Data(read)] = &all[..] else { unreachable!() };
        assert_eq!(read.inline_qos.related.map(|SampleIdentity { sequence, .. }| sequence.0), sequence);
    }
}

#[test]
fn fragments_are_those_of_their_sample_without_padding() {
    let fragments = |first: u32, count: u16, size: u16, sample: u32, payload: usize| {
        let numbers =
            [&first.to_le_bytes()[..], &count.to_le_bytes(), &size.to_le_bytes(), &sample.to_le_bytes()].concat();
        frame(0x16, 0, &[&[0, 0, 28, 0], &ENTITIES, &number(1), &numbers, &vec![5; payload]])
    };
    for (first, count, size, sample, payload, length) in [
        (1, 1, 100, 250, 100, Some(100)),
        (2, 2, 100, 250, 150, Some(150)),
        (3, 1, 100, 250, 52, Some(50)),
        (1, 3, 100, 250, 250, Some(250)),
        (u32::MAX, 1, 1, u32::MAX, 1, Some(1)),
        (1, 1, 100, 250, 99, None),
        (0, 1, 100, 250, 100, None),
        (4, 1, 100, 250, 100, None),
        (3, 2, 100, 250, 200, None),
        (1, 0, 100, 250, 0, None),
        (1, 1, 0, 250, 0, None),
        (1, 1, 100, 0, 100, None),
        (1, 1, 251, 250, 251, None),
        (u32::MAX, u16::MAX, u16::MAX, u32::MAX, 100, None),
    ] {
        let all = read(&datagram(&[&fragments(first, count, size, sample, payload), &heartbeat_frame(1, 1)]));
        let found = match &all[..] {
            [Submessage::DataFrag(data), _] => Some(data.payload.len()),
            _ => None,
        };
        assert_eq!(found, length, "{first} {count} {size} {sample}");
    }
}

#[test]
fn one_datagram_has_at_most_1024_submessages_and_65507_bytes() {
    let many = datagram(&[&heartbeat_frame(1, 1).repeat(1100)]);
    assert_eq!(read(&many).len(), SUBMESSAGES_MAX);
    let skipped = datagram(&[&frame(0x01, 0, &[]).repeat(SUBMESSAGES_MAX), &heartbeat_frame(1, 1)]);
    assert_eq!(read(&skipped).len(), 0);
    let large = datagram(&[&heartbeat_frame(1, 1), &frame(0x80, 0, &[&[0; 60_000]]), &frame(0x80, 0, &[&[0; 6000]])]);
    assert!(large.len() > DATAGRAM_BYTES_MAX && read(&large).is_empty());
}

#[test]
fn destination_and_time_are_written_when_they_change() {
    let mut builder = DatagramBuilder::new(SOURCE);
    builder.destination(GuidPrefix::UNKNOWN);
    builder.timestamp(None);
    assert_eq!(builder.bytes(), 20);
    for _ in 0..2 {
        builder.destination(GuidPrefix([1; 12]));
        builder.timestamp(Some(Ticks(5)));
        assert_eq!(builder.bytes(), 20 + 16 + 12);
    }
    builder.timestamp(None);
    assert_eq!(builder.bytes(), 20 + 16 + 12 + 4);
}

#[test]
fn a_payload_keeps_its_options_and_its_padding_and_is_padded_to_four_bytes() {
    for (payload, read_back) in
        [(&[0, 7, 0, 3, 5, 0, 0, 0][..], &[0, 7, 0, 3, 5, 0, 0, 0][..]), (&[0, 1, 0, 0, 5], &[0, 1, 0, 0, 5, 0, 0, 0])]
    {
        let mut builder = DatagramBuilder::in_order(ByteOrder::Little, SOURCE);
        builder.push(&properties::data_with(Payload::Data(Bytes::copy_from_slice(payload))));
        let expected = properties::data_with(Payload::Data(Bytes::copy_from_slice(read_back)));
        assert_eq!(read(&builder.finish()), [expected]);
    }
}

#[test]
fn an_empty_set_takes_no_words() {
    let acknack = |set| {
        let (reader, writer) = (EntityId::SPDP_READER, EntityId::SPDP_WRITER);
        Submessage::AckNack(super::submessage::AckNack { reader, writer, missing: set, count: 1, is_final: false })
    };
    assert_eq!(DatagramBuilder::bytes_of(&acknack(NumberSet::new(1))), 28);
    let mut set = NumberSet::new(1);
    set.insert(32);
    assert_eq!(DatagramBuilder::bytes_of(&acknack(set.clone())), 32);
    set.insert(33);
    assert_eq!(DatagramBuilder::bytes_of(&acknack(set)), 36);
}
