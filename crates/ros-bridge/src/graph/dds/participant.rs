//! The participant of a ROS domain.

use std::{sync::Arc, time::Duration};

use ros_message::Library;
use rustdds::{DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity, Topic, TopicKind};

use super::{
    failure::dds_error,
    guid::prefix,
    ros_discovery::{RosDiscovery, node_name as node_name_of},
};
use crate::{
    error::{Error, Explained, Result},
    graph::{
        domain::DOMAIN_MAX,
        names::{TopicName, TypeName},
        qos::Qos,
        reach::{Range, Reach},
    },
};

/// How long others keep a participant that was killed. It announces itself five times in it.
pub(crate) const LEASE: Duration = Duration::from_secs(6);

/// Our presence in one ROS domain: a DDS participant with one ROS 2 node. Cloning shares it; it
/// leaves the domain when the last clone, reader and writer are gone.
#[derive(Clone)]
pub struct Participant {
    pub(super) dds: DomainParticipant,
    pub(super) discovery: Arc<RosDiscovery>,
    /// Is every process that it hears on this host, with the same clock?
    pub(super) is_alone: bool,
}

impl Participant {
    /// Joins a domain with the processes of this host; as [`Participant::join`].
    pub async fn open(domain: u16, node_name: &str) -> Result<Self> {
        Self::join(domain, node_name, &Reach::default()).await
    }

    /// Joins a domain as the node `node_name` (shown by `ros2 node list`). Fails if the domain is out of
    /// range, the name is not valid, or the UDP ports of the domain cannot be opened.
    pub async fn join(domain: u16, node_name: &str, reach: &Reach) -> Result<Self> {
        if domain > DOMAIN_MAX {
            let wanted = format!("0 to {DOMAIN_MAX}");
            let hint = "domains up to 101 are safe on every system";
            let what = "ROS domain id is out of range";
            return Err(Error::Setting(Explained::new(what, domain.to_string(), wanted, hint)));
        }
        let node = node_name_of(node_name)?;
        let reach = reach.clone();
        let is_alone = reach.range == Range::Localhost && reach.static_peers.is_empty();
        let join = move || {
            let mut builder = DomainParticipantBuilder::new(domain)
                .only_local(reach.range == Range::Localhost)
                .static_peers(reach.peers())
                .participant_lease(LEASE);
            if let Some(interfaces) = reach.interfaces {
                builder = builder.with_only_networks(interfaces);
            }
            let dds =
                builder.build().map_err(|error| dds_error(&format!("cannot join ROS domain {domain}"), &error))?;
            let discovery = Arc::new(RosDiscovery::announce(&dds, node)?);
            Ok(Self { dds, discovery, is_alone })
        };
        let joined = tokio::task::spawn_blocking(join).await;
        joined.map_err(|error| dds_error(&format!("cannot join ROS domain {domain}"), &error))?
    }

    /// The GUID of the participant: unique in the world, new with every start.
    pub fn guid(&self) -> [u8; 16] {
        self.dds.guid().to_bytes()
    }

    /// Loses DDS as a fault would take it away.
    #[cfg(test)]
    pub(crate) fn break_down(&self) {
        self.dds.end_event_loop();
    }

    /// The ROS domain.
    pub fn domain(&self) -> u16 {
        self.dds.domain_id()
    }

    /// These policies with the hash of the type, as `rmw` announces it. It is computed from the definition; for a type
    /// without one it is taken from somebody in the graph who knows it.
    pub(super) fn with_type_hash(&self, policies: QosPolicies, message: &TypeName) -> QosPolicies {
        let computed = Library::builtin().message(&message.to_string()).ok().map(|message| message.type_hash());
        match computed.or_else(|| self.hash_in_graph(&message.dds())) {
            Some(hash) => policies.with_user_data(format!("typehash={hash};").into_bytes()),
            None => policies,
        }
    }

    pub(super) fn guid_prefix(&self) -> [u8; 12] {
        prefix(self.dds.guid())
    }

    pub(super) fn topic(&self, topic: &TopicName, message: &TypeName, qos: &Qos) -> Result<Topic> {
        qos.validate()?;
        let kind = if qos.keyed { TopicKind::WithKey } else { TopicKind::NoKey };
        self.dds
            .create_topic(topic.dds(), message.dds(), &qos.policies(), kind)
            .map_err(|error| dds_error(&format!("cannot open topic {topic} [{message}]"), &error))
    }
}

impl std::fmt::Debug for Participant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Participant").field("guid", &hex::encode(self.guid())).finish_non_exhaustive()
    }
}
