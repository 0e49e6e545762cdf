//! Announcements of DDS participants and endpoints are rejected, or say the same when they are written again in either byte order.
#![no_main]

use bytes::Bytes;
use libfuzzer_sys::fuzz_target;
use rtps::announcement::{ByteOrder, EndpointData, ParticipantData, key_of};
use rtps::limits::{LOCATORS_MAX, NAME_BYTES_MAX, PARTITIONS_MAX, REPRESENTATIONS_MAX, USER_DATA_BYTES_MAX};

const ORDERS: [ByteOrder; 2] = [ByteOrder::Little, ByteOrder::Big];

fuzz_target!(|bytes: &[u8]| {
    let payload = Bytes::copy_from_slice(bytes);
    if let Ok(data) = ParticipantData::from_payload(&payload) {
        let locators = [&data.discovery_unicast, &data.discovery_multicast, &data.data_unicast, &data.data_multicast];
        assert!(locators.iter().all(|list| list.len() <= LOCATORS_MAX));
        assert!(data.name.len() <= NAME_BYTES_MAX && data.user_data.len() <= USER_DATA_BYTES_MAX);
        for order in ORDERS {
            assert_eq!(ParticipantData::from_payload(&data.to_payload_in(order)).as_ref(), Ok(&data));
        }
    }
    if let Ok(data) = EndpointData::from_payload(&payload) {
        assert!(data.unicast.len() <= LOCATORS_MAX && data.multicast.len() <= LOCATORS_MAX);
        assert!(data.qos.partitions.len() <= PARTITIONS_MAX && data.qos.representations.len() <= REPRESENTATIONS_MAX);
        let names = [&data.topic.name, &data.topic.type_name];
        assert!(names.into_iter().chain(&data.qos.partitions).all(|name| name.len() <= NAME_BYTES_MAX));
        // Other locators than UDP over IPv4 are noted, not kept.
        let kept = EndpointData { has_other_locators: false, ..data };
        for order in ORDERS {
            let written = kept.to_payload_in(order);
            assert_eq!(EndpointData::from_payload(&written).as_ref(), Ok(&kept));
            assert_eq!(key_of(&written).map(|guid| guid.prefix), Some(kept.guid.prefix));
        }
    }
    let _ = key_of(&payload);
});
