//! The bridge as other ROS 2 tools see it: one node with its readers and writers.
//!
//! Every ROS 2 participant publishes on `ros_discovery_info` which nodes it holds and which DDS
//! endpoints belong to each. Without it `ros2 topic info` shows our endpoints as of an unknown node.

use std::{
    collections::BTreeSet,
    sync::{Mutex, PoisonError},
};

use ros2_client::{
    Gid, NodeName,
    builtin_topics::ros_discovery::{QOS_PUB, TOPIC_NAME, TYPE_NAME},
    entities_info::{NodeEntitiesInfo, ParticipantEntitiesInfo},
};
use rustdds::{DomainParticipant, GUID, RTPSEntity, TopicKind, no_key::DataWriterCdr};

use super::failure::dds_error;
use crate::{
    error::{Error, Explained, Result},
    graph::names::TYPE_NAME_BYTES_MAX,
};

/// Whether an endpoint of ours reads or writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    Reads,
    Writes,
}

/// Our node and its endpoints, announced anew with every change.
pub(super) struct RosDiscovery {
    participant: GUID,
    node: NodeName,
    endpoints: Mutex<BTreeSet<(Role, [u8; 16])>>,
    announcements: DataWriterCdr<ParticipantEntitiesInfo>,
}

/// Checks the name of a node and puts it into the root namespace.
pub(super) fn node_name(name: &str) -> Result<NodeName> {
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
    pub(super) fn announce(dds: &DomainParticipant, node: NodeName) -> Result<Self> {
        let failed = |error| dds_error("cannot announce the bridge as a ROS 2 node", &error);
        let topic =
            dds.create_topic(TOPIC_NAME.into(), TYPE_NAME.into(), &QOS_PUB, TopicKind::NoKey).map_err(failed)?;
        let publisher = dds.create_publisher(&QOS_PUB).map_err(failed)?;
        let announcements = publisher.create_datawriter_no_key_cdr(&topic, None).map_err(failed)?;
        let graph = Self { participant: dds.guid(), node, endpoints: Mutex::default(), announcements };
        graph.change(|_| ());
        Ok(graph)
    }

    pub(super) fn add(&self, role: Role, endpoint: GUID) {
        self.change(|endpoints| {
            endpoints.insert((role, endpoint.to_bytes()));
        });
    }

    pub(super) fn remove(&self, role: Role, endpoint: GUID) {
        self.change(|endpoints| {
            endpoints.remove(&(role, endpoint.to_bytes()));
        });
    }

    /// Changes the endpoints and publishes them under one lock, so that announcements keep the order of the
    /// changes. A lost announcement harms only what tools show, so it is logged and nothing else.
    fn change(&self, change: impl FnOnce(&mut BTreeSet<(Role, [u8; 16])>)) {
        let mut endpoints = self.endpoints.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut endpoints);
        let mut node = NodeEntitiesInfo::new(self.node.clone());
        for (role, guid) in endpoints.iter() {
            match role {
                Role::Reads => node.add_reader(Gid::from(*guid)),
                Role::Writes => node.add_writer(Gid::from(*guid)),
            }
        }
        let info = ParticipantEntitiesInfo::new(Gid::from(self.participant), vec![node]);
        if let Err(error) = self.announcements.write(info, None) {
            tracing::warn!(%error, "ros2 node info will be out of date: cannot announce the bridge");
        }
    }
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
}
