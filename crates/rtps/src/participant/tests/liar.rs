//! Changes what a participant sends, under its own name: ranges, counts, sizes, endpoints of others, bytes.

use super::random::Random;
use crate::announcement::{EndpointData, key_payload};
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::interface::TopicDescription;
use crate::qos::Qos;
use crate::wire::read;
use crate::wire::submessage::{Data, DataFrag, Gap, InlineQos, NumberSet, Payload, Submessage};
use crate::wire::write::DatagramBuilder;
use bytes::Bytes;
use std::net::{Ipv4Addr, SocketAddrV4};

/// The datagram of a liar as it arrives: half of it is true, so that others follow it.
pub(super) fn lie(random: &mut Random, own: GuidPrefix, datagram: &Bytes) -> Bytes {
    if random.chance(50) {
        return datagram.clone();
    }
    if random.chance(10) {
        return damaged(random, datagram);
    }
    let mut builder = DatagramBuilder::new(own);
    for mut message in read::submessages(datagram) {
        builder.destination(message.destination);
        builder.timestamp(message.timestamp);
        if random.chance(50) {
            change(random, &mut message.submessage);
        }
        builder.push(&message.submessage);
    }
    for _ in 0..random.below(3) {
        builder.push(&made_up(random, own));
    }
    let bytes = builder.finish();
    if bytes.len() > crate::limits::DATAGRAM_BYTES_MAX { datagram.clone() } else { bytes }
}

/// Bytes behind the header are changed, or the end is missing.
fn damaged(random: &mut Random, datagram: &Bytes) -> Bytes {
    let mut bytes = datagram.to_vec();
    for _ in 0..=random.below(8) {
        let at = 20 + random.index(bytes.len().saturating_sub(20));
        if let Some(byte) = bytes.get_mut(at) {
            *byte = u8::try_from(random.below(256)).unwrap();
        }
    }
    if random.chance(30) {
        bytes.truncate(20 + random.index(bytes.len()));
    }
    bytes.into()
}

fn number(random: &mut Random, before: i64) -> i64 {
    match random.below(8) {
        0 => i64::MAX,
        1 => i64::MIN,
        2 => 0,
        3 => -1,
        4 => before.saturating_add(1_000_000_000),
        5 => random.next().cast_signed(),
        6 => before.saturating_sub(i64::try_from(random.below(300)).unwrap()),
        _ => before.saturating_add(i64::try_from(random.below(300)).unwrap()),
    }
}

fn small(random: &mut Random) -> u32 {
    let any = u32::try_from(random.next() >> 32).unwrap();
    random.of(&[0, 1, 2, 255, 256, 257, u32::MAX, any])
}

fn set(random: &mut Random, set: &mut NumberSet) {
    set.base = number(random, set.base);
    set.bits = small(random).min(256);
    set.bitmap = std::array::from_fn(|_| small(random));
}

fn change(random: &mut Random, submessage: &mut Submessage) {
    let any = small(random).cast_signed();
    match submessage {
        Submessage::Data(data) => data.sequence = SequenceNumber(number(random, data.sequence.0)),
        Submessage::DataFrag(fragment) => match random.below(4) {
            0 => fragment.sequence = SequenceNumber(number(random, fragment.sequence.0)),
            1 => fragment.first = small(random),
            2 => fragment.sample_bytes = small(random),
            _ => fragment.fragment_bytes = u16::try_from(small(random) & 0xffff).unwrap(),
        },
        Submessage::Heartbeat(heartbeat) => {
            heartbeat.first = SequenceNumber(number(random, heartbeat.first.0));
            heartbeat.last = SequenceNumber(number(random, heartbeat.last.0));
            heartbeat.count = any;
        }
        Submessage::HeartbeatFrag(heartbeat) => {
            heartbeat.sequence = SequenceNumber(number(random, heartbeat.sequence.0));
            heartbeat.last = small(random);
        }
        Submessage::AckNack(acknack) => {
            set(random, &mut acknack.missing);
            acknack.count = any;
        }
        Submessage::NackFrag(nack) => {
            nack.sequence = SequenceNumber(number(random, nack.sequence.0));
            set(random, &mut nack.missing);
        }
        Submessage::Gap(gap) => {
            gap.start = SequenceNumber(number(random, gap.start.0));
            set(random, &mut gap.list);
        }
    }
}

/// Endpoints of others are announced and closed; samples in their names; fragments of samples that never come.
fn made_up(random: &mut Random, own: GuidPrefix) -> Submessage {
    let mut victim = own;
    if let Some(last) = victim.0.last_mut() {
        *last = u8::try_from(random.below(8)).unwrap();
    }
    let key = u32::try_from(random.below(6)).unwrap();
    let is_writer = random.chance(50);
    let entity = if is_writer { EntityId::writer(key, false) } else { EntityId::reader(key, false) };
    let guid = Guid::new(random.of(&[victim, own]), entity);
    let sequence = SequenceNumber(i64::try_from(random.below(20)).unwrap());
    let announcer = if is_writer { EntityId::PUBLICATIONS_WRITER } else { EntityId::SUBSCRIPTIONS_WRITER };
    let data = |writer, sequence, inline_qos, payload| {
        Submessage::Data(Data { reader: EntityId::UNKNOWN, writer, sequence, inline_qos, payload })
    };
    match random.below(5) {
        0 => {
            let topic = TopicDescription { name: "rt/t0".into(), type_name: "T".into(), keyed: false };
            let unicast = vec![SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 1), 7411)];
            let (qos, user_data, multicast) = (Qos::default(), Bytes::new(), Vec::new());
            let data_ = EndpointData { guid, topic, qos, user_data, unicast, multicast, has_other_locators: false };
            data(announcer, sequence, InlineQos::default(), Payload::Data(data_.to_payload()))
        }
        1 => {
            let inline_qos = InlineQos { status: 3, key_hash: Some(guid.to_bytes()), related: None };
            data(announcer, sequence, inline_qos, Payload::Key(key_payload(guid)))
        }
        2 => {
            let participant = Guid::new(victim, EntityId::PARTICIPANT);
            let inline_qos = InlineQos { status: 3, key_hash: Some(participant.to_bytes()), related: None };
            let payload = if victim == own { Payload::None } else { Payload::Key(key_payload(participant)) };
            data(EntityId::SPDP_WRITER, sequence, inline_qos, payload)
        }
        3 => Submessage::Gap(Gap {
            reader: EntityId::UNKNOWN,
            writer: random.of(&[announcer, EntityId::writer(key, false)]),
            start: SequenceNumber(1),
            list: NumberSet::new(number(random, 1)),
        }),
        _ => Submessage::DataFrag(DataFrag {
            reader: EntityId::UNKNOWN,
            writer: random.of(&[announcer, EntityId::writer(key, false)]),
            sequence,
            first: 1 + small(random) % 1000,
            count: 1,
            fragment_bytes: 100,
            sample_bytes: random.of(&[1000, 4_000_000_000, 16_000_000]),
            inline_qos: InlineQos::default(),
            is_key: false,
            payload: vec![0; 100].into(),
        }),
    }
}
