//! The bridge as other ROS 2 tools see it: one node with its readers and writers.
//!
//! Every ROS 2 participant publishes on `ros_discovery_info` which nodes it holds and which DDS endpoints belong to each. Without it
//! `ros2 topic info` shows the endpoints of the bridge as those of an unknown node.

use std::{
    collections::BTreeSet,
    sync::{Mutex, PoisonError},
};

use bytes::{BufMut, Bytes, BytesMut};
use ledger_gate::sample::{CDR_LE, HEADER_BYTES};
use ros2_client::NodeName;
use rtps::{
    guid::{GUID_BYTES, Guid},
    interface::{EndpointSettings, OutgoingSample, TopicDescription},
    io::{Domain, DomainWriter},
    qos::{Durability, History, Qos as Policies, Reliability},
};

use super::failure::dds_error;
use crate::{
    error::{Error, Explained, Result},
    graph::names::TYPE_NAME_BYTES_MAX,
};

/// The topic, without the prefix of topics of applications.
const TOPIC: &str = "ros_discovery_info";
/// Its type.
const TYPE: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

/// Whether an endpoint of ours reads or writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    Reads,
    Writes,
}

/// Announces our node and its endpoints with every change.
pub(super) struct RosDiscovery {
    participant: Guid,
    node: NodeName,
    endpoints: Mutex<BTreeSet<(Role, Guid)>>,
    announcements: DomainWriter,
}

/// Checks the name of a node and puts it into the root namespace.
pub(crate) fn node_name(name: &str) -> Result<NodeName> {
    let fault = if name.len() > TYPE_NAME_BYTES_MAX {
        Some(format!("{} bytes", name.len()))
    } else {
        NodeName::new("/", name).err().map(|error| format!("{name:?} ({error})"))
    };
    match (fault, NodeName::new("/", name)) {
        (None, Ok(node)) => Ok(node),
        (fault, _) => {
            let wanted = format!("letters, digits and '_', at most {TYPE_NAME_BYTES_MAX} bytes");
            let found = fault.unwrap_or_default();
            Err(Error::Name(Explained::new("node name is not valid", found, wanted, "\"ledgerd_bridge\"")))
        }
    }
}

impl RosDiscovery {
    /// Announces a node without endpoints.
    pub(super) fn announce(domain: &Domain, node: NodeName) -> Result<Self> {
        let settings = EndpointSettings {
            topic: TopicDescription { name: TOPIC.to_owned(), type_name: TYPE.to_owned(), keyed: false },
            qos: Policies {
                reliability: Reliability::Reliable,
                durability: Durability::TransientLocal,
                history: History::KeepLast(1),
                ..Policies::default()
            },
            user_data: Bytes::new(),
            without_history: false,
        };
        let announcements =
            domain.writer(settings).map_err(|error| dds_error("cannot announce the bridge as a ROS 2 node", &error))?;
        let graph = Self { participant: domain.guid(), node, endpoints: Mutex::default(), announcements };
        graph.change(|_| ());
        Ok(graph)
    }

    pub(super) fn add(&self, role: Role, endpoint: Guid) {
        self.change(|endpoints| {
            endpoints.insert((role, endpoint));
        });
    }

    pub(super) fn remove(&self, role: Role, endpoint: Guid) {
        self.change(|endpoints| {
            endpoints.remove(&(role, endpoint));
        });
    }

    /// Changes the endpoints and publishes them under one lock, so that announcements keep the order of the
    /// changes. A lost announcement harms only what tools show, so it is logged and nothing else.
    fn change(&self, change: impl FnOnce(&mut BTreeSet<(Role, Guid)>)) {
        let mut endpoints = self.endpoints.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut endpoints);
        let payload = entities_info(self.participant, &self.node, &endpoints);
        if let Err(error) = self.announcements.write(OutgoingSample { payload, timestamp: None, related: None }) {
            tracing::warn!(%error, "ros2 node info will be out of date: cannot announce the bridge");
        }
    }
}

/// A message `rmw_dds_common/msg/ParticipantEntitiesInfo` with one node, as CDR with its encapsulation header. Identifiers have 16 bytes
/// since ROS 2 Iron.
fn entities_info(participant: Guid, node: &NodeName, endpoints: &BTreeSet<(Role, Guid)>) -> Bytes {
    let mut cdr = BytesMut::with_capacity(256 + endpoints.len() * GUID_BYTES);
    cdr.put_slice(&CDR_LE);
    cdr.put_slice(&[0, 0]);
    cdr.put_slice(&participant.to_bytes());
    put_length(&mut cdr, 1);
    for text in [node.namespace(), node.base_name()] {
        put_length(&mut cdr, text.len() + 1);
        cdr.put_slice(text.as_bytes());
        cdr.put_u8(0);
    }
    for role in [Role::Reads, Role::Writes] {
        let of_role: Vec<&Guid> = endpoints.iter().filter(|(of, _)| *of == role).map(|(_, guid)| guid).collect();
        put_length(&mut cdr, of_role.len());
        of_role.iter().for_each(|guid| cdr.put_slice(&guid.to_bytes()));
    }
    cdr.freeze()
}

/// Appends a length in four bytes, aligned behind the encapsulation header.
fn put_length(cdr: &mut BytesMut, length: usize) {
    let aligned = (cdr.len() - HEADER_BYTES).next_multiple_of(4) + HEADER_BYTES;
    cdr.resize(aligned, 0);
    cdr.put_u32_le(u32::try_from(length).unwrap_or(u32::MAX));
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn node_names_follow_the_rules_of_ros() {
        assert_eq!(node_name("ledgerd_bridge").unwrap().fully_qualified_name(), "/ledgerd_bridge");
        for bad in ["", "/x", "two words", "1st", &"a".repeat(300)] {
            assert!(node_name(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_node_is_announced_with_its_readers_and_writers() {
        let guid = |number| Guid::from_bytes([number; GUID_BYTES]);
        let endpoints = BTreeSet::from([(Role::Writes, guid(2)), (Role::Reads, guid(3))]);
        let cdr = entities_info(guid(1), &node_name("bridge").unwrap(), &endpoints);
        let wanted = [
            &[0, 1, 0, 0][..],
            &[1; 16],
            &[1, 0, 0, 0],
            &[2, 0, 0, 0],
            b"/\0",
            &[0, 0],
            &[7, 0, 0, 0],
            b"bridge\0",
            &[0],
            &[1, 0, 0, 0],
            &[3; 16],
            &[1, 0, 0, 0],
            &[2; 16],
        ];
        assert_eq!(cdr, wanted.concat());
    }
}
