//! Participants and datagrams by hand.

use super::network::{Network, config};
use crate::Participant;
use crate::announcement::{EndpointData, ParticipantData, key_payload};
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber, VendorId};
use crate::interface::{Channel, EndpointSettings, Input, Output, TopicDescription};
use crate::qos::{Durability, Qos, Reliability};
use crate::time::Now;
use crate::wire::read;
use crate::wire::submessage::{Data, Heartbeat, InlineQos, Payload, Submessage};
use crate::wire::write::DatagramBuilder;
use bytes::Bytes;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

pub(super) const LEASE: u64 = 1_000_000;
pub(super) const STRANGER: GuidPrefix = GuidPrefix([0xee; 12]);
pub(super) const FROM: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 99), 7411);

pub(super) fn topic(name: &str, keyed: bool) -> TopicDescription {
    TopicDescription { name: name.into(), type_name: "T".into(), keyed }
}

pub(super) fn settings(name: &str, qos: Qos) -> EndpointSettings {
    EndpointSettings { topic: topic(name, false), qos, user_data: Bytes::new(), without_history: false }
}

pub(super) fn reliable(durability: Durability) -> Qos {
    Qos { reliability: Reliability::Reliable, durability, ..Qos::default() }
}

pub(super) fn network(slots: usize) -> Network {
    let mut network = Network::new(7, (0..slots).map(|slot| config(slot, 1, LEASE)));
    (0..slots).for_each(|slot| network.start(slot));
    network
}

/// The announcement of a participant by hand.
pub(super) fn participant_data(prefix: GuidPrefix) -> ParticipantData {
    ParticipantData {
        prefix,
        vendor: VendorId::CYCLONE,
        domain: Some(0),
        lease: Duration::from_micros(LEASE),
        discovery_unicast: vec![FROM],
        discovery_multicast: Vec::new(),
        data_unicast: vec![FROM],
        data_multicast: Vec::new(),
        builtin_endpoints: 0xc3f,
        name: String::new(),
        user_data: Bytes::new(),
    }
}

pub(super) fn endpoint_data(guid: Guid) -> EndpointData {
    let (qos, user_data, unicast, multicast) = (Qos::default(), Bytes::new(), Vec::new(), Vec::new());
    EndpointData { guid, topic: topic("rt/t", false), qos, user_data, unicast, multicast, has_other_locators: false }
}

pub(super) fn data(writer: EntityId, sequence: i64, payload: Payload, inline_qos: InlineQos) -> Submessage {
    Submessage::Data(Data {
        reader: EntityId::UNKNOWN,
        writer,
        sequence: SequenceNumber(sequence),
        inline_qos,
        payload,
    })
}

pub(super) fn announced(data_: &ParticipantData) -> Submessage {
    data(EntityId::SPDP_WRITER, 1, Payload::Data(data_.to_payload()), InlineQos::default())
}

pub(super) fn published(sequence: i64, endpoint: &EndpointData) -> Submessage {
    data(EntityId::PUBLICATIONS_WRITER, sequence, Payload::Data(endpoint.to_payload()), InlineQos::default())
}

pub(super) fn disposed(writer: EntityId, sequence: i64, guid: Guid) -> Submessage {
    let inline_qos = InlineQos { status: 3, key_hash: Some(guid.to_bytes()), related: None };
    data(writer, sequence, Payload::Key(key_payload(guid)), inline_qos)
}

/// The writers from the first one on are announced.
pub(super) fn heartbeat(last: i64) -> Submessage {
    Submessage::Heartbeat(Heartbeat {
        reader: EntityId::UNKNOWN,
        writer: EntityId::PUBLICATIONS_WRITER,
        first: SequenceNumber(1),
        last: SequenceNumber(last),
        count: 1,
        is_final: true,
        is_alive: false,
    })
}

/// A HEARTBEAT follows what is published.
pub(super) fn datagram(source: GuidPrefix, submessages: &[Submessage]) -> Input {
    let mut builder = DatagramBuilder::new(source);
    submessages.iter().for_each(|submessage| builder.push(submessage));
    let number = |submessage: &Submessage| match submessage {
        Submessage::Data(data) if data.writer == EntityId::PUBLICATIONS_WRITER => Some(data.sequence),
        _ => None,
    };
    if let Some(last) = submessages.iter().filter_map(number).max() {
        builder.push(&heartbeat(last.0));
    }
    Input::Datagram { from: FROM, channel: Channel::DiscoveryUnicast, bytes: builder.finish() }
}

pub(super) fn alone() -> Participant {
    Participant::new(config(0, 1, LEASE), Now::default())
}

pub(super) fn at(steady: u64) -> Now {
    Now { steady, wall: steady }
}

pub(super) fn step(participant: &mut Participant, steady: u64, input: Input) -> Vec<Output> {
    let mut out = Vec::new();
    participant.step(at(steady), input, &mut out);
    out
}

pub(super) fn found(out: &[Output]) -> Vec<Guid> {
    let guid = |output: &Output| match output {
        Output::Found(endpoint) => Some(endpoint.guid),
        _ => None,
    };
    out.iter().filter_map(guid).collect()
}

pub(super) fn gone(out: &[Output]) -> Vec<Guid> {
    let guid = |output: &Output| match output {
        Output::Gone(guid) => Some(*guid),
        _ => None,
    };
    out.iter().filter_map(guid).collect()
}

/// Datagrams with data of the participant, and whither.
pub(super) fn announcements(out: &[Output]) -> Vec<Vec<SocketAddrV4>> {
    let is_announcement = |message: crate::wire::submessage::Addressed| matches!(message.submessage, Submessage::Data(data) if data.writer == EntityId::SPDP_WRITER);
    let to = |output: &Output| match output {
        Output::Send { to, bytes } if read::submessages(bytes).any(is_announcement) => Some(to.clone()),
        _ => None,
    };
    out.iter().filter_map(to).collect()
}

pub(super) fn writer_of(prefix: GuidPrefix, key: u32) -> Guid {
    Guid::new(prefix, EntityId::writer(key, false))
}
