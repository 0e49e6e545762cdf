use super::*;
use crate::qos::{Durability, LivelinessKind, Ownership, Representation};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;

fn bytes(most: usize) -> impl Strategy<Value = Bytes> {
    vec(any::<u8>(), 0..=most).prop_map(Bytes::from)
}

fn duration() -> impl Strategy<Value = Ticks> {
    prop_oneof![Just(Ticks::INFINITE), Just(Ticks::ZERO), (0..0x7fff_ffff_0000_0000_u64).prop_map(Ticks)]
}

fn addresses(multicast: bool) -> impl Strategy<Value = Vec<SocketAddrV4>> {
    let first = if multicast { 224..240_u8 } else { 1..224_u8 };
    let address = (first, any::<[u8; 3]>(), 1..=u16::MAX)
        .prop_map(|(a, [b, c, d], port)| SocketAddrV4::new(Ipv4Addr::new(a, b, c, d), port));
    prop::collection::btree_set(address, 0..=LOCATORS_MAX).prop_map(|set| set.into_iter().collect())
}

fn participants() -> impl Strategy<Value = ParticipantData> {
    let identity = (any::<[u8; 12]>(), any::<[u8; 2]>(), option::of(any::<u32>()), any::<u32>());
    // Nanoseconds come back; shorter times are not on the wire.
    let lease = prop_oneof![Just(Duration::MAX), (0..2_000_000_000_000_000_000_u64).prop_map(Duration::from_nanos)];
    let locators = (addresses(false), addresses(true), addresses(false), addresses(true));
    (identity, lease, locators, ".{0,64}", bytes(USER_DATA_BYTES_MAX)).prop_filter_map(
        "not unknown",
        |((prefix, vendor, domain, builtin_endpoints), lease, locators, name, user_data)| {
            let (discovery_unicast, discovery_multicast, data_unicast, data_multicast) = locators;
            let data = ParticipantData {
                prefix: GuidPrefix(prefix),
                vendor: VendorId(vendor),
                domain,
                lease,
                discovery_unicast,
                discovery_multicast,
                data_unicast,
                data_multicast,
                builtin_endpoints,
                name: name.trim_end_matches('\0').to_owned(),
                user_data,
            };
            (data.prefix != GuidPrefix::UNKNOWN).then_some(data)
        },
    )
}

fn policies() -> impl Strategy<Value = Qos> {
    let kinds = (
        prop::sample::select(vec![Reliability::BestEffort, Reliability::Reliable]),
        prop::sample::select(vec![
            Durability::Volatile,
            Durability::TransientLocal,
            Durability::Transient,
            Durability::Persistent,
        ]),
        prop_oneof![Just(History::KeepAll), (0..0x8000_0000_u32).prop_map(History::KeepLast)],
        prop::sample::select(vec![
            LivelinessKind::Automatic,
            LivelinessKind::ManualByParticipant,
            LivelinessKind::ManualByTopic,
        ]),
        prop::sample::select(vec![Ownership::Shared, Ownership::Exclusive]),
    );
    let times = (duration(), duration(), duration(), duration());
    let lists = (vec("[a-z*?]{0,9}", 0..5), vec(any::<i16>().prop_map(Representation), 0..5));
    (kinds, times, lists).prop_map(
        |((reliability, durability, history, liveliness, ownership), times, (partitions, representations))| {
            let (deadline, liveliness_lease, lifespan, latency_budget) = times;
            Qos {
                reliability,
                durability,
                history,
                deadline,
                liveliness,
                liveliness_lease,
                lifespan,
                latency_budget,
                ownership,
                partitions,
                representations,
            }
        },
    )
}

fn endpoints() -> impl Strategy<Value = EndpointData> {
    let identity = (any::<[u8; 12]>(), 0..0x0100_0000_u32, any::<bool>(), any::<bool>());
    let names = ("[ -~]{0,256}", "[ -~]{0,256}");
    (identity, names, policies(), bytes(USER_DATA_BYTES_MAX), addresses(false), addresses(true)).prop_map(
        |((prefix, key, is_writer, keyed), (name, type_name), qos, user_data, unicast, multicast)| {
            let entity = if is_writer { EntityId::writer(key, keyed) } else { EntityId::reader(key, keyed) };
            EndpointData {
                guid: Guid::new(GuidPrefix(prefix), entity),
                topic: TopicDescription { name, type_name, keyed },
                qos,
                user_data,
                unicast,
                multicast,
                has_other_locators: false,
            }
        },
    )
}

/// Reads it as each kind of announcement.
fn read_as_all(payload: &Bytes) {
    if let Ok(data) = ParticipantData::from_payload(payload) {
        assert!(data.discovery_unicast.len() <= LOCATORS_MAX && data.user_data.len() <= USER_DATA_BYTES_MAX);
    }
    if let Ok(data) = EndpointData::from_payload(payload) {
        assert!(data.unicast.len() <= LOCATORS_MAX && data.user_data.len() <= USER_DATA_BYTES_MAX);
    }
    key_of(payload);
}

proptest! {
    #[test]
    fn a_participant_is_read_back(data in participants(), is_little: bool) {
        let order = if is_little { ByteOrder::Little } else { ByteOrder::Big };
        prop_assert_eq!(ParticipantData::from_payload(&data.to_payload_in(order)), Ok(data.clone()));
        prop_assert_eq!(ParticipantData::from_payload(&data.to_payload()), Ok(data));
    }

    #[test]
    fn an_endpoint_is_read_back(data in endpoints(), is_little: bool) {
        let order = if is_little { ByteOrder::Little } else { ByteOrder::Big };
        prop_assert_eq!(EndpointData::from_payload(&data.to_payload_in(order)), Ok(data.clone()));
        prop_assert_eq!(EndpointData::from_payload(&data.to_payload()), Ok(data));
    }

    #[test]
    fn arbitrary_parameters_are_read_within_bounds(bytes in vec(any::<u8>(), 0..300), encapsulation in 0..4_u8) {
        read_as_all(&[vec![0, encapsulation, 0, 0], bytes].concat().into());
    }

    #[test]
    fn changed_announcements_are_read_within_bounds(
        (participant, endpoint) in (participants(), endpoints()),
        changes in vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        for payload in [participant.to_payload(), endpoint.to_payload()] {
            let mut payload = payload.to_vec();
            for (at, byte) in &changes {
                let at = at.index(payload.len());
                payload[at] = *byte;
            }
            read_as_all(&payload.into());
        }
    }
}
