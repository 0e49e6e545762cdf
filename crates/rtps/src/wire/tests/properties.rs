use super::{SOURCE, read};
use crate::guid::{EntityId, Guid, GuidPrefix, SampleIdentity, SequenceNumber};
use crate::limits::SUBMESSAGES_MAX;
use crate::time::Ticks;
use crate::wire::cursor::ByteOrder;
use crate::wire::read::submessages;
use crate::wire::submessage::{
    AckNack, Addressed, Data, DataFrag, Gap, Heartbeat, HeartbeatFrag, InlineQos, NackFrag, NumberSet, Payload,
    Submessage,
};
use crate::wire::write::DatagramBuilder;
use bytes::Bytes;
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;

/// DATA with this payload.
pub(super) fn data_with(payload: Payload) -> Submessage {
    let (reader, writer) = (EntityId::UNKNOWN, EntityId::writer(1, false));
    Submessage::Data(Data { reader, writer, sequence: SequenceNumber(1), inline_qos: InlineQos::default(), payload })
}

fn entity() -> impl Strategy<Value = EntityId> {
    any::<[u8; 4]>().prop_map(EntityId)
}

fn prefix() -> impl Strategy<Value = GuidPrefix> {
    any::<[u8; 12]>().prop_map(GuidPrefix)
}

fn sequence() -> impl Strategy<Value = SequenceNumber> {
    prop_oneof![1..=100_i64, 1..=i64::MAX].prop_map(SequenceNumber)
}

fn set(bases: impl Strategy<Value = i64>) -> impl Strategy<Value = NumberSet> {
    (bases, vec(0..256_i64, 0..20)).prop_map(|(base, offsets)| {
        let mut set = NumberSet::new(base);
        offsets.into_iter().for_each(|offset| assert!(set.insert(base + offset)));
        set
    })
}

fn inline_qos() -> impl Strategy<Value = InlineQos> {
    let identity = (any::<[u8; 16]>(), any::<i64>()).prop_map(|(writer, sequence)| SampleIdentity {
        writer: Guid::from_bytes(writer),
        sequence: SequenceNumber(sequence),
    });
    (option::of(identity), 0..4_u32, option::of(any::<[u8; 16]>())).prop_map(|(related, status, key_hash)| InlineQos {
        related,
        status,
        key_hash,
    })
}

/// A multiple of four bytes, which come back as they are.
fn words(most: usize) -> impl Strategy<Value = Bytes> {
    vec(any::<[u8; 4]>(), 0..most).prop_map(|words| words.concat().into())
}

fn payload() -> impl Strategy<Value = Payload> {
    prop_oneof![Just(Payload::None), words(50).prop_map(Payload::Data), words(10).prop_map(Payload::Key)]
}

fn fragments() -> impl Strategy<Value = DataFrag> {
    let sizes =
        (1..200_u16, 1..2000_u32).prop_filter("a fragment is not larger", |(size, sample)| u32::from(*size) <= *sample);
    let run = sizes.prop_flat_map(|(size, sample)| {
        let total = sample.div_ceil(size.into());
        (Just(size), Just(sample), 1..=total).prop_flat_map(move |(size, sample, first)| {
            (Just(size), Just(sample), Just(first), 1..=u16::try_from(total - first + 1).unwrap())
        })
    });
    (entity(), entity(), sequence(), run, inline_qos(), any::<bool>()).prop_map(
        |(reader, writer, sequence, (fragment_bytes, sample_bytes, first, count), inline_qos, is_key)| {
            let start = (first - 1) * u32::from(fragment_bytes);
            let end = sample_bytes.min(start + u32::from(count) * u32::from(fragment_bytes));
            let payload = (start..end).map(|byte| byte.to_le_bytes()[0]).collect();
            DataFrag {
                reader,
                writer,
                sequence,
                first,
                count,
                fragment_bytes,
                sample_bytes,
                inline_qos,
                is_key,
                payload,
            }
        },
    )
}

fn submessage() -> impl Strategy<Value = Submessage> {
    let ends = || (entity(), entity());
    let flags = (any::<bool>(), any::<bool>());
    prop_oneof![
        (ends(), sequence(), inline_qos(), payload()).prop_map(|((reader, writer), sequence, inline_qos, payload)| {
            Submessage::Data(Data { reader, writer, sequence, inline_qos, payload })
        }),
        fragments().prop_map(Submessage::DataFrag),
        (ends(), sequence(), sequence(), any::<i32>(), flags).prop_map(
            |((reader, writer), a, b, count, (is_final, is_alive))| {
                let (first, last) = (a.min(b), a.max(b));
                Submessage::Heartbeat(Heartbeat { reader, writer, first, last, count, is_final, is_alive })
            }
        ),
        (ends(), sequence(), 1..=u32::MAX, any::<i32>()).prop_map(|((reader, writer), sequence, last, count)| {
            Submessage::HeartbeatFrag(HeartbeatFrag { reader, writer, sequence, last, count })
        }),
        (ends(), set(0..=i64::MAX - 256), any::<i32>(), any::<bool>()).prop_map(
            |((reader, writer), missing, count, is_final)| {
                Submessage::AckNack(AckNack { reader, writer, missing, count, is_final })
            }
        ),
        (ends(), sequence(), set(1..=i64::from(u32::MAX) - 256), any::<i32>()).prop_map(
            |((reader, writer), sequence, missing, count)| {
                Submessage::NackFrag(NackFrag { reader, writer, sequence, missing, count })
            }
        ),
        (ends(), sequence(), set(0..=i64::MAX - 256))
            .prop_map(|((reader, writer), start, list)| Submessage::Gap(Gap { reader, writer, start, list })),
    ]
}

fn addressed() -> impl Strategy<Value = Addressed> {
    let time = option::of((0..u64::MAX).prop_map(Ticks));
    (prop_oneof![Just(GuidPrefix::UNKNOWN), prefix()], time, submessage()).prop_map(
        |(destination, timestamp, submessage)| Addressed { source: SOURCE, destination, timestamp, submessage },
    )
}

fn written(order: ByteOrder, messages: &[Addressed]) -> Bytes {
    let mut builder = DatagramBuilder::in_order(order, SOURCE);
    for message in messages {
        builder.destination(message.destination);
        builder.timestamp(message.timestamp);
        let before = builder.bytes();
        builder.push(&message.submessage);
        assert_eq!(builder.bytes() - before, DatagramBuilder::bytes_of(&message.submessage));
    }
    let bytes = builder.bytes();
    let datagram = builder.finish();
    assert_eq!(datagram.len(), bytes);
    datagram
}

/// Reads an untrusted datagram, and checks that the result is bounded.
fn read_bounded(datagram: &Bytes) {
    let mut payload_bytes = 0;
    let mut count = 0;
    for message in submessages(datagram) {
        count += 1;
        payload_bytes += match &message.submessage {
            Submessage::Data(Data { payload: Payload::Data(bytes) | Payload::Key(bytes), .. }) => bytes.len(),
            Submessage::DataFrag(data) => data.payload.len(),
            Submessage::AckNack(acknack) => acknack.missing.iter().count() / 8,
            Submessage::NackFrag(nack) => nack.missing.iter().count() / 8,
            Submessage::Gap(gap) => gap.list.iter().count() / 8,
            _ => 0,
        };
    }
    assert!(count <= SUBMESSAGES_MAX && payload_bytes <= datagram.len());
}

proptest! {
    #[test]
    fn what_is_written_is_read_back(messages in vec(addressed(), 0..6), is_little: bool) {
        let order = if is_little { ByteOrder::Little } else { ByteOrder::Big };
        let datagram = written(order, &messages);
        prop_assert_eq!(submessages(&datagram).collect::<Vec<_>>(), messages);
    }

    #[test]
    fn arbitrary_bytes_are_read_within_bounds(bytes in vec(any::<u8>(), 0..600), has_header: bool) {
        let header = [b"RTPS\x02\x05\x01\x10", &SOURCE.0[..]].concat();
        read_bounded(&if has_header { [header, bytes].concat() } else { bytes }.into());
    }

    #[test]
    fn changed_datagrams_are_read_within_bounds(
        messages in vec(addressed(), 1..4),
        is_little: bool,
        changes in vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        end in any::<prop::sample::Index>(),
    ) {
        let order = if is_little { ByteOrder::Little } else { ByteOrder::Big };
        let mut datagram = written(order, &messages).to_vec();
        for (at, byte) in changes {
            let at = at.index(datagram.len());
            datagram[at] = byte;
        }
        read_bounded(&datagram.clone().into());
        datagram.truncate(end.index(datagram.len()));
        read_bounded(&datagram.into());
    }

    #[test]
    fn a_datagram_cut_short_loses_only_its_end(messages in vec(addressed(), 1..4), end in any::<prop::sample::Index>()) {
        let datagram = written(ByteOrder::Little, &messages);
        let cut = datagram.slice(..end.index(datagram.len()));
        let all: Vec<_> = messages.into_iter().map(|message| message.submessage).collect();
        prop_assert!(all.starts_with(&read(&cut)));
    }
}
