//! A participant that was found, and its endpoints.

use super::locators::{Route, route};
use crate::announcement::{EndpointData, ParticipantData};
use crate::endpoint::Peer;
use crate::guid::{EntityId, Guid, VendorId};
use crate::interface::{Channel, Config, RemoteEndpoint, UnreachableParticipant};
use crate::limits::{LOCATORS_MAX, PARTITIONS_MAX, REPRESENTATIONS_MAX};
use crate::qos::{Durability, Reliability, Representation};
use crate::time::{Now, micros};
use bytes::Bytes;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddrV4};

/// Shortest lease that is kept to, microseconds: a shorter one would end between two datagrams.
pub(crate) const LEASE_MIN: u64 = 100_000;
/// Longest lease that is kept to, microseconds: five minutes. A stranger cannot take a place for longer by one datagram.
pub(crate) const LEASE_MAX: u64 = 300_000_000;
/// Largest endpoint that is kept, bytes of its names, partitions and USER_DATA: what fits in one announcement without fragments.
pub(crate) const ENDPOINT_BYTES_MAX: usize = 4096;

/// Most memory that an endpoint takes, bytes.
const ENDPOINT_MEMORY_MAX: usize = 8 * 1024;
/// Most memory that a participant takes without its endpoints, bytes. Its three pairs of builtin endpoints take 44 KiB more.
const PARTICIPANT_MEMORY_MAX: usize = 4 * 1024;
/// Addresses: those that are announced, and the way.
const ADDRESSES_BYTES: usize = 2 * LOCATORS_MAX * size_of::<SocketAddrV4>();
const _: () = assert!(
    ENDPOINT_MEMORY_MAX
        >= size_of::<RemoteEntry>()
            + ENDPOINT_BYTES_MAX
            + ADDRESSES_BYTES
            + PARTITIONS_MAX * size_of::<String>()
            + REPRESENTATIONS_MAX * size_of::<Representation>()
);
const _: () = assert!(PARTICIPANT_MEMORY_MAX >= size_of::<RemoteParticipant>() + 4 * ADDRESSES_BYTES);

/// A participant of others.
#[derive(Debug)]
pub(crate) struct RemoteParticipant {
    /// Without its name and USER_DATA.
    data: ParticipantData,
    /// The way to its builtin endpoints.
    discovery: Route,
    /// The announced address from which it was heard, and when last.
    source: Option<(Ipv4Addr, u64)>,
    /// The host from which it announced itself last.
    host: Ipv4Addr,
    /// Was it ever heard by multicast? Then it probably hears multicast as well.
    pub(crate) is_heard_by_multicast: bool,
    pub(crate) endpoints: BTreeMap<EntityId, RemoteEntry>,
}

/// An endpoint of others.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct RemoteEntry {
    pub(crate) endpoint: RemoteEndpoint,
    /// Its own addresses; empty: those of its participant.
    locators: Vec<SocketAddrV4>,
    route: Route,
}

impl RemoteParticipant {
    pub(crate) fn new(config: &Config, now: Now, data: ParticipantData, from: SocketAddrV4, channel: Channel) -> Self {
        let mut participant = Self {
            discovery: Route::default(),
            source: None,
            host: *from.ip(),
            is_heard_by_multicast: channel == Channel::DiscoveryMulticast,
            endpoints: BTreeMap::new(),
            data: stripped(data),
        };
        participant.note_source(now, *from.ip());
        participant.discovery = participant.route(config, &participant.data.discovery_unicast);
        participant
    }

    /// How long it is kept after its last sign of life, microseconds.
    pub(crate) fn lease(&self) -> u64 {
        micros(self.data.lease).clamp(LEASE_MIN, LEASE_MAX)
    }

    /// Its builtin endpoints (`PID_BUILTIN_ENDPOINT_SET`).
    pub(crate) fn builtin_endpoints(&self) -> u32 {
        self.data.builtin_endpoints
    }

    /// The addresses of its builtin endpoints.
    pub(crate) fn discovery_addresses(&self) -> &[SocketAddrV4] {
        &self.discovery.to
    }

    /// How it is reported if its builtin endpoints cannot be reached.
    pub(crate) fn unreachable(&self) -> Option<UnreachableParticipant> {
        self.discovery.to.is_empty().then(|| UnreachableParticipant {
            guid: Guid::new(self.data.prefix, EntityId::PARTICIPANT),
            vendor: self.data.vendor,
            host: self.host,
        })
    }

    /// It has announced itself again. Returns the endpoints whose ways have changed; `None` if all is as before.
    pub(crate) fn update(
        &mut self,
        config: &Config,
        now: Now,
        data: ParticipantData,
        from: SocketAddrV4,
        channel: Channel,
    ) -> Option<Vec<EntityId>> {
        self.is_heard_by_multicast |= channel == Channel::DiscoveryMulticast;
        self.host = *from.ip();
        let data = stripped(data);
        let is_other_source = self.note_source(now, *from.ip());
        if data == self.data && !is_other_source {
            return None;
        }
        self.data = data;
        self.discovery = self.route(config, &self.data.discovery_unicast);
        let mut moved = Vec::new();
        let mut endpoints = std::mem::take(&mut self.endpoints);
        for (entity, entry) in &mut endpoints {
            let route = self.endpoint_route(config, &entry.locators);
            if route != entry.route {
                entry.endpoint.is_reachable = !route.to.is_empty();
                entry.route = route;
                moved.push(*entity);
            }
        }
        self.endpoints = endpoints;
        Some(moved)
    }

    /// An endpoint of it, as it is announced. `None` if it is too large.
    pub(crate) fn entry(&self, config: &Config, data: EndpointData) -> Option<RemoteEntry> {
        let partitions: usize = data.qos.partitions.iter().map(String::len).sum();
        let bytes = data.topic.name.len() + data.topic.type_name.len() + partitions + data.user_data.len();
        if bytes > ENDPOINT_BYTES_MAX {
            return None;
        }
        let mut locators = if data.unicast.is_empty() { data.multicast } else { data.unicast };
        locators.truncate(LOCATORS_MAX);
        let route = self.endpoint_route(config, &locators);
        if route.to.is_empty() {
            let others = data.has_other_locators;
            tracing::debug!(guid = %data.guid, others, "an endpoint has no address of UDP over IPv4");
        }
        let endpoint = RemoteEndpoint {
            guid: data.guid,
            vendor: self.data.vendor,
            topic: data.topic,
            qos: data.qos,
            user_data: data.user_data,
            is_reachable: !route.to.is_empty(),
        };
        Some(RemoteEntry { endpoint, locators, route })
    }

    /// Its builtin endpoints as the other side of a match; they are all reliable and keep what they announce.
    pub(crate) fn builtin_peer(&self) -> Option<Peer> {
        let guid = Guid::new(self.data.prefix, EntityId::PARTICIPANT);
        self.peer(guid, &self.discovery, true, true)
    }

    /// An endpoint as the other side of a match. `None` if it cannot be reached.
    pub(crate) fn endpoint_peer(&self, entry: &RemoteEntry) -> Option<Peer> {
        let qos = &entry.endpoint.qos;
        let is_reliable = qos.reliability == Reliability::Reliable;
        self.peer(entry.endpoint.guid, &entry.route, is_reliable, qos.durability >= Durability::TransientLocal)
    }

    fn peer(&self, guid: Guid, route: &Route, is_reliable: bool, is_durable: bool) -> Option<Peer> {
        (!route.to.is_empty()).then(|| Peer {
            guid,
            is_reliable,
            is_durable,
            unicast: route.to.clone(),
            is_local: route.is_local,
            is_fast_dds: self.data.vendor == VendorId::FAST_DDS,
        })
    }

    fn route(&self, config: &Config, announced: &[SocketAddrV4]) -> Route {
        route(config, announced, self.source.map(|(ip, _)| ip))
    }

    fn endpoint_route(&self, config: &Config, locators: &[SocketAddrV4]) -> Route {
        let of_participant = || match self.data.data_unicast.as_slice() {
            [] => self.data.data_multicast.as_slice(),
            unicast => unicast,
        };
        self.route(config, if locators.is_empty() { of_participant() } else { locators })
    }

    /// The address from which it sends. One that works is kept until nothing has come from it for a lease. Returns whether it changes.
    fn note_source(&mut self, now: Now, from: Ipv4Addr) -> bool {
        let announced = |ip: Ipv4Addr| self.data.discovery_unicast.iter().any(|to| *to.ip() == ip);
        if !announced(from) {
            return false;
        }
        match self.source {
            Some((ip, at)) if ip != from && announced(ip) && now.steady.saturating_sub(at) < self.lease() => false,
            before => {
                self.source = Some((from, now.steady));
                before.is_none_or(|(ip, _)| ip != from)
            }
        }
    }
}

/// The data of a participant that are kept.
fn stripped(data: ParticipantData) -> ParticipantData {
    ParticipantData { name: String::new(), user_data: Bytes::new(), ..data }
}
