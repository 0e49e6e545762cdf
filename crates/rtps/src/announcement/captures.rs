//! Datagrams of CycloneDDS and Fast DDS are read with the names, policies and numbers that their programs set.
#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]

use super::*;
use crate::guid::{SampleIdentity, SequenceNumber};
use crate::qos::{Durability, History, LivelinessKind, Reliability, Representation};
use crate::time::Ticks;
use crate::wire::read::submessages;
use crate::wire::submessage::{
    AckNack, Addressed, Data, DataFrag, Gap, Heartbeat, HeartbeatFrag, NumberSet, Payload, Submessage,
};

/// The datagrams of a file, each with the submessages that were read of it.
fn datagrams(text: &str) -> Vec<Vec<Addressed>> {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    lines.map(|line| submessages(&line.as_bytes().chunks(2).map(byte).collect::<Bytes>()).collect()).collect()
}

fn cyclone() -> Vec<Vec<Addressed>> {
    datagrams(include_str!("captures/cyclonedds-11.0.1.hex"))
}

fn fast_dds() -> Vec<Vec<Addressed>> {
    datagrams(include_str!("captures/fastdds-2.14.5.hex"))
}

fn data(message: &Addressed) -> &Data {
    match &message.submessage {
        Submessage::Data(data) => data,
        other => panic!("{other:?}"),
    }
}

fn sample(message: &Addressed) -> &Bytes {
    match &data(message).payload {
        Payload::Data(bytes) => bytes,
        other => panic!("{other:?}"),
    }
}

fn endpoint(message: &Addressed) -> EndpointData {
    EndpointData::from_payload(sample(message)).unwrap()
}

fn topics(messages: &[Addressed]) -> Vec<String> {
    messages
        .iter()
        .filter(|one| matches!(one.submessage, Submessage::Data(_)))
        .map(|one| endpoint(one).topic.name)
        .collect()
}

fn seconds(seconds: u64) -> Ticks {
    Ticks(seconds << 32)
}

/// Offers that the writer of `rt/cmd_vel` and that of `rt/words` offer both.
fn offered() -> Qos {
    Qos {
        reliability: Reliability::Reliable,
        durability: Durability::TransientLocal,
        deadline: Ticks::from_micros(1_500_000),
        liveliness_lease: seconds(3),
        ..Qos::default()
    }
}

#[test]
fn participants_are_read() {
    let data = ParticipantData::from_payload(sample(&cyclone()[0][0])).unwrap();
    assert_eq!((data.vendor, data.domain, data.lease), (VendorId::CYCLONE, Some(7), Duration::from_secs(10)));
    assert_eq!(data.discovery_unicast, ["127.0.0.1:9160".parse().unwrap()]);
    assert_eq!(data.data_unicast, ["127.0.0.1:9161".parse().unwrap()]);
    assert_eq!((data.builtin_endpoints, &data.user_data[..]), (0xfc3f, &b"enclave=/;"[..]));
    assert_eq!(data.prefix, cyclone()[0][0].source);

    let data = ParticipantData::from_payload(sample(&fast_dds()[0][0])).unwrap();
    assert_eq!((data.vendor, data.domain, data.lease), (VendorId::FAST_DDS, None, Duration::from_secs(20)));
    assert_eq!(data.discovery_unicast, ["127.0.0.1:9162".parse().unwrap()]);
    // A zero at the end is part of it.
    assert_eq!((data.builtin_endpoints, &data.user_data[..], &data.name[..]), (0xc3f, &b"enclave=/;\0"[..], "/"));
    assert_eq!(data.prefix, fast_dds()[0][0].source);
}

#[test]
fn writers_are_read() {
    let writer = endpoint(&cyclone()[1][0]);
    assert_eq!(
        (&writer.topic.name[..], &writer.topic.type_name[..]),
        ("rt/cmd_vel", "geometry_msgs::msg::dds_::Twist_")
    );
    let qos = Qos {
        history: History::KeepLast(10),
        liveliness: LivelinessKind::ManualByParticipant,
        lifespan: writer.qos.lifespan,
        latency_budget: writer.qos.latency_budget,
        partitions: vec!["left".to_owned(), "right*".to_owned()],
        ..offered()
    };
    assert_eq!(writer.qos, qos);
    // CycloneDDS rounds fractions up.
    assert_eq!(writer.qos.lifespan.to_nanos(), Some(100_000_068_719_476));
    assert_eq!(writer.qos.latency_budget.to_nanos(), Some(5_000_000));
    assert_eq!((&writer.user_data[..], writer.unicast.len()), (&b"typehash=RIHS01_00;"[..], 0));
    let keyed = endpoint(&cyclone()[2][0]);
    assert_eq!((keyed.topic.keyed, &keyed.topic.name[..], writer.topic.keyed), (true, "keyed", false));

    let messages = &fast_dds()[1];
    assert_eq!(topics(messages), ["rr/node_pub/get_type_descriptionReply", "rt/words"]);
    let writer = endpoint(&messages[1]);
    assert_eq!(writer.topic.type_name, "std_msgs::msg::dds_::String_");
    let representations = vec![Representation::XCDR1];
    assert_eq!(writer.qos, Qos { lifespan: writer.qos.lifespan, representations, ..offered() });
    assert_eq!(writer.qos.lifespan.to_nanos(), Some(100_000_068_719_476));
    assert!(writer.user_data.starts_with(b"typehash=RIHS01_df668c74") && writer.user_data.ends_with(b"6b1a18;"));
    assert_eq!(writer.unicast, ["127.0.0.1:9163".parse().unwrap()]);
}

#[test]
fn readers_are_read_and_match_the_writers_of_their_topics() {
    let messages = &cyclone()[3];
    assert_eq!(topics(&messages[5..]), ["rt/cmd_vel", "keyed", "rt/image"]);
    let reader = endpoint(&messages[5]);
    assert!(reader.guid.entity.is_reader());
    assert_eq!(endpoint(&cyclone()[1][0]).qos.mismatches(&reader.qos), []);

    let messages = &fast_dds()[2];
    assert_eq!(topics(messages), ["rt/words", "rt/image"]);
    assert_eq!(endpoint(&fast_dds()[1][1]).qos.mismatches(&endpoint(&messages[0]).qos), []);
    assert_eq!(endpoint(&messages[1]).qos.durability, Durability::Volatile);
}

#[test]
fn samples_are_read() {
    let [message, heartbeat] = &cyclone()[4][..] else { panic!() };
    assert_eq!((data(message).writer, data(message).sequence), (EntityId([0, 0, 2, 3]), SequenceNumber(1)));
    assert_eq!(sample(message).len(), 4 + 6 * 8);
    assert_eq!(sample(message)[4..12], 1_f64.to_le_bytes());
    assert_eq!(message.timestamp.and_then(Ticks::to_micros).unwrap() / 1_000_000, 1_795_950_888);
    let Submessage::Heartbeat(Heartbeat { first, last, count, is_final, .. }) = heartbeat.submessage else { panic!() };
    assert_eq!((first.0, last.0, count, is_final), (1, 1, 2, false));

    let [one, two] = &fast_dds()[5][..] else { panic!() };
    assert_eq!((data(one).sequence.0, data(two).sequence.0), (1, 2));
    assert_eq!([sample(one), sample(two)].map(|bytes| &bytes[8..]), [b"one\0", b"two\0"]);
    assert!(one.timestamp < two.timestamp);
    assert_eq!(one.destination, fast_dds()[3][0].source);
}

#[test]
fn fragments_are_read() {
    let [fragments, heartbeat] = &cyclone()[6][..] else { panic!() };
    let Submessage::DataFrag(DataFrag { first, count, fragment_bytes, sample_bytes, payload, .. }) =
        &fragments.submessage
    else {
        panic!()
    };
    assert_eq!((*first, *count, *fragment_bytes, *sample_bytes, payload.len()), (1, 2, 600, 2552, 1200));
    assert!(matches!(heartbeat.submessage, Submessage::HeartbeatFrag(HeartbeatFrag { last: 2, count: 1, .. })));

    let [fragment] = &fast_dds()[8][..] else { panic!() };
    let Submessage::DataFrag(DataFrag { first, count, fragment_bytes, sample_bytes, payload, .. }) =
        &fragment.submessage
    else {
        panic!()
    };
    assert_eq!((*first, *count, *fragment_bytes, *sample_bytes, payload.len()), (3, 1, 1024, 2548, 500));
}

#[test]
fn a_reply_of_fast_dds_names_its_request_and_a_request_the_reader_of_its_replies() {
    let (request, reply) = (&fast_dds()[6][0], &fast_dds()[7][0]);
    let reader = Guid::new(request.source, EntityId([0, 0, 8, 4]));
    let related = |sequence| Some(SampleIdentity { writer: reader, sequence });
    assert_eq!(data(request).inline_qos.related, related(SequenceNumber::UNKNOWN));
    assert_eq!(data(reply).inline_qos.related, related(SequenceNumber(1)));
    assert_eq!((sample(request)[4], &sample(reply)[12..14]), (1, &b"hi"[..]));
}

#[test]
fn requests_for_samples_and_gaps_are_read() {
    let missing: Vec<_> = cyclone()[3]
        .iter()
        .filter_map(|message| match &message.submessage {
            Submessage::AckNack(AckNack { writer, missing, .. }) => Some((*writer, missing.iter().collect::<Vec<_>>())),
            _ => None,
        })
        .collect();
    assert_eq!(missing[..2], [(EntityId::PUBLICATIONS_WRITER, vec![]), (EntityId::SUBSCRIPTIONS_WRITER, vec![])]);
    assert_eq!(missing.len(), 5);

    let set = |message: &Addressed| match &message.submessage {
        Submessage::AckNack(AckNack { missing, count, is_final, .. }) => (missing.clone(), *count, *is_final),
        other => panic!("{other:?}"),
    };
    assert_eq!(set(&fast_dds()[3][0]), (NumberSet::new(0), 1, false));
    let (missing, count, is_final) = set(&fast_dds()[4][0]);
    assert_eq!((missing.iter().collect::<Vec<_>>(), count, is_final), (vec![1, 2], 2, false));
    let [gap, heartbeat] = &fast_dds()[10][..] else { panic!() };
    let Submessage::Gap(Gap { start, list, .. }) = &gap.submessage else { panic!() };
    assert_eq!((start.0, list), (4, &NumberSet::new(5)));
    assert!(matches!(heartbeat.submessage, Submessage::Heartbeat(Heartbeat { last: SequenceNumber(7), .. })));
}

#[test]
fn what_is_disposed_of_is_read() {
    let disposed = data(&cyclone()[5][0]).clone();
    assert_eq!((disposed.inline_qos.status, disposed.inline_qos.key_hash), (1, None));
    assert_eq!(disposed.payload, Payload::Key(Bytes::from_static(&[0, 1, 0, 0, 5, 0, 0, 0])));
    // CycloneDDS sends the key of an announcement, Fast DDS its hash alone.
    let writer = endpoint(&cyclone()[1][0]).guid;
    for (index, guid) in [(7, writer), (8, Guid::new(writer.prefix, EntityId::PARTICIPANT))] {
        let gone = data(&cyclone()[index][0]).clone();
        let Payload::Key(key) = &gone.payload else { panic!() };
        assert_eq!((gone.inline_qos.status, key_of(key)), (3, Some(guid)));
    }
    let writer = endpoint(&fast_dds()[1][1]).guid;
    for (index, guid) in [(9, writer), (11, Guid::new(writer.prefix, EntityId::PARTICIPANT))] {
        let gone = data(&fast_dds()[index][0]).clone();
        assert_eq!((gone.inline_qos.status, gone.inline_qos.key_hash), (3, Some(guid.to_bytes())));
        assert_eq!(gone.payload, Payload::None);
    }
}
