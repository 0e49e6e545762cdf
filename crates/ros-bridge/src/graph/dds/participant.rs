//! The participant of a ROS domain.

use std::{
    net::{IpAddr, Ipv4Addr},
    sync::Arc,
    time::Duration,
};

use bytes::Bytes;
use ros_message::Library;
use rtps::{
    interface::TopicDescription,
    io::{Domain, DomainSettings},
};

use super::{
    failure::dds_error,
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
/// The USER_DATA of a participant: ROS 2 keeps the name of the security enclave there.
const ENCLAVE: &[u8] = b"enclave=/;";

/// Our presence in one ROS domain: a DDS participant with one ROS 2 node. Cloning shares it; it
/// leaves the domain when the last clone, reader and writer are gone.
#[derive(Clone)]
pub struct Participant {
    pub(super) dds: Domain,
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
        let failed = |error: &dyn std::error::Error| dds_error(&format!("cannot join ROS domain {domain}"), error);
        let asked = reach.clone();
        let peers = tokio::task::spawn_blocking(move || asked.peers()).await.map_err(|error| failed(&error))?;
        let v4 = |address| match address {
            IpAddr::V4(address) => Some(address),
            IpAddr::V6(_) => None,
        };
        let static_peers: Vec<Ipv4Addr> = peers.into_iter().filter_map(v4).collect();
        let settings = DomainSettings {
            domain,
            only_local: reach.range == Range::Localhost,
            interfaces: reach.interfaces.clone(),
            static_peers,
            lease: LEASE,
            name: node.base_name().to_owned(),
            user_data: Bytes::from_static(ENCLAVE),
        };
        let dds = Domain::join(settings).await.map_err(|error| failed(&error))?;
        let discovery = Arc::new(RosDiscovery::announce(&dds, node)?);
        let is_alone = reach.range == Range::Localhost && reach.static_peers.is_empty();
        Ok(Self { dds, discovery, is_alone })
    }

    /// The GUID of the participant: unique in the world, new with every start.
    pub fn guid(&self) -> [u8; 16] {
        self.dds.guid().to_bytes()
    }

    /// The hosts of participants that have no address for UDP over IPv4, one for each.
    pub(crate) fn unreachable(&self) -> Vec<Ipv4Addr> {
        self.dds.unreachable().into_iter().map(|participant| participant.host).collect()
    }

    /// Loses DDS as a fault would take it away.
    #[cfg(test)]
    pub(crate) fn break_down(&self) {
        self.dds.end();
    }

    /// The ROS domain.
    pub fn domain(&self) -> u16 {
        self.dds.domain()
    }

    /// The USER_DATA of an endpoint with the hash of its type, as `rmw` announces it. It is computed from the definition; for a type
    /// without one it is taken from an endpoint in the graph that announces it.
    pub(super) fn type_hash(&self, message: &TypeName) -> Bytes {
        let computed = Library::builtin().message(&message.to_string()).ok().map(|message| message.type_hash());
        match computed.or_else(|| self.hash_in_graph(&message.dds())) {
            Some(hash) => Bytes::from(format!("typehash={hash};")),
            None => Bytes::new(),
        }
    }
}

/// A topic as an endpoint of DDS names it.
///
/// # Errors
/// [`Error::Setting`] if the settings are out of range.
pub(super) fn described(topic: &TopicName, message: &TypeName, qos: &Qos) -> Result<TopicDescription> {
    qos.validate()?;
    Ok(TopicDescription { name: topic.dds(), type_name: message.dds(), keyed: qos.keyed })
}

impl std::fmt::Debug for Participant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Participant").field("guid", &hex::encode(self.guid())).finish_non_exhaustive()
    }
}
