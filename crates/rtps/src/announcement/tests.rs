#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

mod properties;

use super::*;
use crate::limits::{LOCATORS_MAX, USER_DATA_BYTES_MAX};
use crate::qos::{History, Reliability};
use crate::time::Ticks;
use crate::wire::cursor::ByteOrder;
use std::net::Ipv4Addr;

const PREFIX: GuidPrefix = GuidPrefix([3; 12]);
const WRITER: EntityId = EntityId([0, 0, 1, 0x03]);
const READER: EntityId = EntityId([0, 0, 1, 0x04]);

/// A little-endian list of parameters, without the sentinel.
fn list(parameters: &[(u16, &[u8])]) -> Vec<u8> {
    let mut bytes = vec![0, 3, 0, 0];
    for (id, value) in parameters {
        let length = u16::try_from(value.len()).unwrap();
        bytes.extend([id.to_le_bytes(), length.to_le_bytes()].concat());
        bytes.extend_from_slice(value);
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    bytes
}

/// The same with the sentinel.
fn payload(parameters: &[(u16, &[u8])]) -> Bytes {
    [list(parameters), vec![1, 0, 0, 0]].concat().into()
}

fn guid(entity: EntityId) -> [u8; 16] {
    Guid::new(PREFIX, entity).to_bytes()
}

fn text(text: &str) -> Vec<u8> {
    let mut bytes = u32::try_from(text.len() + 1).unwrap().to_le_bytes().to_vec();
    bytes.extend(text.bytes().chain([0]));
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// An endpoint that announces nothing but what it must, and these.
fn endpoint(entity: EntityId, more: &[(u16, &[u8])]) -> Result<EndpointData, AnnouncementError> {
    let (guid, topic, kind) = (guid(entity), text("rt/a"), text("b"));
    let mut all: Vec<(u16, &[u8])> =
        vec![(pid::ENDPOINT_GUID, &guid), (pid::TOPIC_NAME, &topic), (pid::TYPE_NAME, &kind)];
    all.extend(more);
    EndpointData::from_payload(&payload(&all))
}

/// A participant that announces nothing but what it must, and these.
fn participant(more: &[(u16, &[u8])]) -> Result<ParticipantData, AnnouncementError> {
    let guid = guid(EntityId::PARTICIPANT);
    let mut all: Vec<(u16, &[u8])> =
        vec![(pid::PARTICIPANT_GUID, &guid), (pid::BUILTIN_ENDPOINT_SET, &[0x3f, 0xc, 0, 0])];
    all.extend(more);
    ParticipantData::from_payload(&payload(&all))
}

fn locator(kind: i32, port: u32, address: [u8; 4]) -> Vec<u8> {
    [&kind.to_le_bytes()[..], &port.to_le_bytes(), &[0; 12], &address].concat()
}

#[test]
fn policies_that_are_not_announced_have_their_defaults() {
    let writer = endpoint(WRITER, &[]).unwrap();
    assert_eq!(writer.qos, Qos { reliability: Reliability::Reliable, ..Qos::default() });
    assert_eq!(endpoint(READER, &[]).unwrap().qos, Qos::default());
    assert_eq!((writer.unicast, writer.user_data, writer.has_other_locators), (vec![], Bytes::new(), false));
    let participant = participant(&[]).unwrap();
    assert_eq!((participant.lease, participant.domain), (Duration::from_secs(100), None));
    assert_eq!((participant.vendor, participant.name), (VendorId::UNKNOWN, String::new()));
}

#[test]
fn whether_a_topic_has_keys_follows_from_the_kind_of_the_endpoint() {
    for (kind, keyed) in [(0x02, true), (0x03, false), (0x04, false), (0x07, true)] {
        assert_eq!(endpoint(EntityId([0, 0, 1, kind]), &[]).unwrap().topic.keyed, keyed);
    }
    assert!(endpoint(EntityId::PARTICIPANT, &[]).is_err());
}

#[test]
fn an_unknown_parameter_is_skipped_unless_it_must_be_understood() {
    for (id, is_taken) in
        [(0x3123, true), (0x8123, true), (0x7123, false), (0xc123, false), (0x4021, true), (0x401a, true)]
    {
        let value = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(endpoint(WRITER, &[(id, &value)]).is_ok(), is_taken, "{id:x}");
        assert!(id == 0x401a || participant(&[(id, &value)]).is_ok() == is_taken, "{id:x}");
    }
}

#[test]
fn another_domain_tag_and_another_major_version_are_rejected() {
    assert!(participant(&[(0x4014, &text(""))]).is_ok() && participant(&[(0x4014, &text("a"))]).is_err());
    for (version, is_taken) in
        [([2, 1, 0, 0], true), ([2, 9, 0, 0], true), ([1, 2, 0, 0], false), ([3, 0, 0, 0], false)]
    {
        assert_eq!(participant(&[(pid::PROTOCOL_VERSION, &version)]).is_ok(), is_taken);
    }
}

#[test]
fn what_identifies_is_required() {
    let (own, name) = (guid(WRITER), text("a"));
    let all: [(u16, &[u8]); 3] = [(pid::ENDPOINT_GUID, &own), (pid::TOPIC_NAME, &name), (pid::TYPE_NAME, &name)];
    assert!(EndpointData::from_payload(&payload(&all)).is_ok());
    for missing in 0..all.len() {
        let rest: Vec<_> =
            (0..).zip(all).filter(|(index, _)| *index != missing).map(|(_, parameter)| parameter).collect();
        assert!(EndpointData::from_payload(&payload(&rest)).is_err());
    }
    let endpoints: (u16, &[u8]) = (pid::BUILTIN_ENDPOINT_SET, &[0; 4]);
    for (guid, is_taken) in [(guid(EntityId::PARTICIPANT), true), (own, false), ([0; 16], false)] {
        let all = [(pid::PARTICIPANT_GUID, &guid[..]), endpoints];
        assert_eq!(ParticipantData::from_payload(&payload(&all)).is_ok(), is_taken);
    }
    assert!(ParticipantData::from_payload(&payload(&[endpoints])).is_err());
    assert!(ParticipantData::from_payload(&payload(&[(pid::PARTICIPANT_GUID, &guid(EntityId::PARTICIPANT))])).is_err());
}

#[test]
fn a_list_without_end_and_another_encapsulation_are_rejected() {
    let all = [(pid::ENDPOINT_GUID, &guid(WRITER)[..])];
    assert_eq!(key_of(&payload(&all)), Some(Guid::new(PREFIX, WRITER)));
    assert!(EndpointData::from_payload(&list(&all).into()).is_err());
    let mut other = payload(&all).to_vec();
    other[1] = 1;
    assert_eq!(key_of(&other.into()), None);
}

#[test]
fn only_udp_over_ipv4_is_kept_and_other_locators_are_noted() {
    let one = [127, 0, 0, 1];
    for (kind, port, address, kept, other) in [
        (1, 7411, one, true, false),
        (1, 0, one, false, false),
        (1, 65_536, one, false, false),
        (1, 7411, [0; 4], false, false),
        (1, 7411, [255; 4], false, false),
        (1, 7411, [239, 255, 0, 1], false, false),
        (-1, 7411, one, false, false),
        (2, 7411, one, false, true),
        (16, 7411, one, false, true),
    ] {
        let data = endpoint(READER, &[(pid::UNICAST_LOCATOR, &locator(kind, port, address))]).unwrap();
        assert_eq!((data.unicast.len() == 1, data.has_other_locators), (kept, other), "{kind} {port} {address:?}");
    }
    let group = locator(1, 7401, [239, 255, 0, 1]);
    let data = participant(&[
        (pid::METATRAFFIC_MULTICAST_LOCATOR, &group),
        (pid::DEFAULT_MULTICAST_LOCATOR, &locator(1, 1, one)),
    ]);
    let data = data.unwrap();
    assert_eq!(data.discovery_multicast, [SocketAddrV4::new(Ipv4Addr::new(239, 255, 0, 1), 7401)]);
    assert_eq!(data.data_multicast, []);
}

#[test]
fn a_locator_counts_once_and_at_most_16_are_kept() {
    let locators: Vec<_> = (0..40_u8).map(|last| locator(1, 7411, [10, 0, 0, last / 2])).collect();
    let parameters: Vec<_> = locators.iter().map(|locator| (pid::UNICAST_LOCATOR, &locator[..])).collect();
    assert_eq!(endpoint(READER, &parameters).unwrap().unicast.len(), LOCATORS_MAX);
    assert_eq!(endpoint(READER, &parameters[..10]).unwrap().unicast.len(), 5);
}

#[test]
fn names_that_are_too_long_are_rejected_and_of_user_data_that_is_too_long_nothing_is_kept() {
    for (length, is_taken) in [(256, true), (257, false)] {
        let name = text(&"a".repeat(length));
        assert_eq!(endpoint(READER, &[(pid::TOPIC_NAME, &name)]).is_ok(), is_taken);
        assert_eq!(participant(&[(pid::ENTITY_NAME, &name)]).unwrap().name.len(), if is_taken { length } else { 0 });
    }
    for (length, kept) in [(USER_DATA_BYTES_MAX, USER_DATA_BYTES_MAX), (USER_DATA_BYTES_MAX + 1, 0)] {
        let data = [&u32::try_from(length).unwrap().to_le_bytes()[..], &vec![5; length]].concat();
        assert_eq!(endpoint(READER, &[(pid::USER_DATA, &data)]).unwrap().user_data.len(), kept);
    }
    assert!(endpoint(READER, &[(pid::USER_DATA, &[255, 255, 255, 255, 1, 2, 3, 4])]).is_err());
}

#[test]
fn user_data_ends_with_its_length_and_not_with_its_parameter() {
    let data = [5, 0, 0, 0, b'a', 0, b'b', 0, 0, 9, 9, 9];
    assert_eq!(endpoint(READER, &[(pid::USER_DATA, &data)]).unwrap().user_data, &b"a\0b\0\0"[..]);
}

#[test]
fn partitions_with_names_that_are_too_long_are_no_default_partition() {
    let (long, short) = (text(&"a".repeat(257)), text("b"));
    let one = [&1_u32.to_le_bytes()[..], &long].concat();
    assert!(endpoint(READER, &[(pid::PARTITION, &one)]).is_err());
    let two = [&2_u32.to_le_bytes()[..], &long, &short].concat();
    assert_eq!(endpoint(READER, &[(pid::PARTITION, &two)]).unwrap().qos.partitions, ["b"]);
    assert!(endpoint(READER, &[(pid::PARTITION, &[255, 255, 255, 255])]).is_err());
}

#[test]
fn durations_from_0x7fffffff_seconds_on_are_infinite_and_negative_ones_are_rejected() {
    for (seconds, fraction, ticks) in [
        (5_u32, 1_u32, Some(Ticks((5 << 32) + 1))),
        (0x7fff_ffff, 0, Some(Ticks::INFINITE)),
        (0x7fff_ffff, 0x7fff_ffff, Some(Ticks::INFINITE)),
        (0x7fff_fffe, u32::MAX, Some(Ticks(0x7fff_fffe_ffff_ffff))),
        (0xffff_ffff, 0, None),
    ] {
        let value = [seconds.to_le_bytes(), fraction.to_le_bytes()].concat();
        assert_eq!(endpoint(READER, &[(pid::DEADLINE, &value)]).ok().map(|data| data.qos.deadline), ticks);
    }
    let infinite = participant(&[(pid::PARTICIPANT_LEASE_DURATION, &[0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff, 0xff])]);
    assert_eq!(infinite.unwrap().lease, Duration::MAX);
}

#[test]
fn values_that_no_policy_has_are_rejected() {
    let number = |number: u32| [&number.to_le_bytes()[..], &[0; 8]].concat();
    for (id, valid, invalid) in [
        (pid::RELIABILITY, vec![1, 2], vec![0, 3]),
        (pid::DURABILITY, vec![0, 3], vec![4]),
        (pid::LIVELINESS, vec![0, 2], vec![3]),
        (pid::OWNERSHIP, vec![0, 1], vec![2]),
        (pid::HISTORY, vec![0, 1], vec![2]),
    ] {
        assert!(valid.iter().all(|value| endpoint(READER, &[(id, &number(*value))]).is_ok()), "{id:x}");
        assert!(invalid.iter().all(|value| endpoint(READER, &[(id, &number(*value))]).is_err()), "{id:x}");
    }
    assert!(endpoint(READER, &[(pid::HISTORY, &[0, 0, 0, 0, 255, 255, 255, 255])]).is_err());
}

#[test]
fn a_key_names_what_was_disposed_of() {
    for entity in [EntityId::PARTICIPANT, WRITER, READER] {
        let guid = Guid::new(PREFIX, entity);
        assert_eq!(key_of(&key_payload(guid)), Some(guid));
    }
    assert_eq!(key_payload(Guid::new(PREFIX, EntityId::PARTICIPANT))[4], 0x50);
    assert_eq!(key_payload(Guid::new(PREFIX, WRITER))[4], 0x5a);
    assert_eq!(key_of(&payload(&[(pid::KEY_HASH, &guid(WRITER))])), Some(Guid::new(PREFIX, WRITER)));
    assert_eq!(key_of(&payload(&[])), None);
}

#[test]
fn a_lifespan_keeps_its_ticks() {
    let mut data = endpoint(WRITER, &[]).unwrap();
    data.qos.lifespan = Ticks::from_nanos(1_000_000_068_719_476_768);
    data.qos.history = History::KeepAll;
    let back = EndpointData::from_payload(&data.to_payload()).unwrap();
    assert_eq!(back.qos.lifespan.to_nanos(), Some(1_000_000_068_719_476_768));
    assert_eq!(back, data);
}

#[test]
fn announcements_carry_the_version_and_the_vendor_of_this_implementation() {
    let ours = [0x15, 0, 4, 0, 2, 5, 0, 0, 0x16, 0, 4, 0, 1, 0x21, 0, 0];
    assert_eq!(endpoint(WRITER, &[]).unwrap().to_payload()[4..20], ours);
    let data = ParticipantData { vendor: VendorId::OWN, ..participant(&[]).unwrap() };
    assert_eq!(data.to_payload()[4..20], ours);
}
