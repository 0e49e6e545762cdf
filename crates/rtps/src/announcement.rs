//! Data of participants and endpoints as discovery sends it (§8.5, §9.6.3): parameter lists.

mod endpoint;
mod locator;
mod participant;
mod payload;
mod policies;

use crate::guid::{EntityId, Guid, GuidPrefix, VendorId};
use crate::interface::TopicDescription;
use crate::qos::Qos;
pub use crate::wire::cursor::ByteOrder;
use crate::wire::cursor::Malformed;
use crate::wire::parameters::ParameterReader;
use crate::wire::pid;
use bytes::Bytes;
use std::net::SocketAddrV4;
use std::time::Duration;

/// A participant announces itself (SPDP, `SPDPdiscoveredParticipantData`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParticipantData {
    /// The participant.
    pub prefix: GuidPrefix,
    /// Its implementation.
    pub vendor: VendorId,
    /// None where it is not announced.
    pub domain: Option<u32>,
    /// [`Duration::MAX`]: it never ends.
    pub lease: Duration,
    /// The addresses of its builtin endpoints.
    pub discovery_unicast: Vec<SocketAddrV4>,
    /// The multicast addresses of its builtin endpoints.
    pub discovery_multicast: Vec<SocketAddrV4>,
    /// The addresses of endpoints that announce none of their own.
    pub data_unicast: Vec<SocketAddrV4>,
    /// The multicast addresses of endpoints that announce none of their own.
    pub data_multicast: Vec<SocketAddrV4>,
    /// `PID_BUILTIN_ENDPOINT_SET`.
    pub builtin_endpoints: u32,
    /// As tools show it.
    pub name: String,
    /// USER_DATA.
    pub user_data: Bytes,
}

/// An endpoint is announced (SEDP, `DiscoveredWriterData` and `DiscoveredReaderData`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndpointData {
    /// The endpoint.
    pub guid: Guid,
    /// Its topic.
    pub topic: TopicDescription,
    /// Offered or requested.
    pub qos: Qos,
    /// USER_DATA.
    pub user_data: Bytes,
    /// Empty: those of its participant.
    pub unicast: Vec<SocketAddrV4>,
    /// Empty: those of its participant.
    pub multicast: Vec<SocketAddrV4>,
    /// Does it name locators that are not UDP over IPv4 (shared memory, TCP, IPv6)? Of own endpoints none are written.
    pub has_other_locators: bool,
}

/// Why the data of others are not taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct AnnouncementError(pub(crate) &'static str);

impl From<Malformed> for AnnouncementError {
    fn from(_: Malformed) -> Self {
        Self("malformed bytes")
    }
}

/// The key of an announcement of a participant or an endpoint (`PID_PARTICIPANT_GUID`, `PID_ENDPOINT_GUID`): what is disposed of.
pub(crate) fn key_payload(guid: Guid) -> Bytes {
    let id = if guid.entity == EntityId::PARTICIPANT { pid::PARTICIPANT_GUID } else { pid::ENDPOINT_GUID };
    payload::write(|list| list.add(id, |value| value.guid(guid)))
}

/// The GUID in the key of something that was disposed of.
pub fn key_of(payload: &Bytes) -> Option<Guid> {
    let mut cursor = payload::open(payload).ok()?;
    let mut list = ParameterReader::new(&mut cursor);
    while let Some((id, mut value)) = list.next().ok()? {
        if matches!(id & !pid::MUST_UNDERSTAND, pid::PARTICIPANT_GUID | pid::ENDPOINT_GUID | pid::KEY_HASH) {
            return value.guid().ok();
        }
    }
    None
}

#[cfg(test)]
mod captures;
#[cfg(test)]
mod tests;
