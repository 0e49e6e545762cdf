//! The DDS side: one participant per ROS domain, readers and writers of raw CDR.
//!
//! # What was found out about RustDDS
//! - **Interfaces.** It uses every interface that has an IPv4 address, `lo` included, and joins the
//!   discovery group on those that can do multicast. IPv6 is not used.
//! - **Without multicast** (a network namespace with only `lo`, many containers) it still announces itself to the first
//!   12 participants of the domain. It does so on `127.0.0.1`, UDP port 7410 + 250 · domain + 2 · index. A CycloneDDS
//!   peer is found if it listens there: interface `lo`, multicast off, peer `127.0.0.1`, participant index `auto`.
//!   There is nothing to set on our side.
//! - **Options of the encapsulation header** were dropped on reading and zero on writing. CycloneDDS puts the count of padding
//!   bytes there, which readers of XCDR2 need. The copy hands them over.
//! - **A DDS writer has one encoding.** [`Writer`] opens a second one when the first sample of
//!   another byte order, or of XCDR2, comes; samples written before readers matched that one are lost, as at any
//!   start.
//! - **History is counted in samples**, and kept per topic after reading: `depth` times the largest
//!   message is the memory of a topic. The bytes that wait for us are limited by [`crate::queue`].
//! - **Volatile readers** requested what a latched writer keeps, and got it as new. Where all processes have one clock, [`Reader`]
//!   passes over what was written before it was opened. Elsewhere the copy gives up what a writer has at first.
//! - **A crashed peer** stays matched until its lease ends (CycloneDDS 10 s, a bridge 6 s). For it, as for a slow one, a
//!   writer of the copy keeps the last samples of its depth, and at most 32 MiB: newer ones replace them. The original
//!   keeps what one reader has not acknowledged, and then writes for nobody.
//! - **A process that was stopped and continues** (SIGSTOP and SIGCONT, a debugger) lost its DDS: the threads that wait
//!   for the sockets took the interruption for a failure. The copy of RustDDS in `vendor` goes on. Should such a thread
//!   end all the same, readers and writers notice it within a second: [`Matched::ended`].
//! - **Other hosts.** Interfaces alone close no door: its unicast sockets are bound to all addresses. The copy drops
//!   datagrams of other hosts by their source address, and keeps multicasts on this host ([`crate::reach`]).
//! - **Large messages** go in bursts with pauses, and lost fragments are sent again at once: the copy does so. Fast DDS has
//!   receive buffers of 200 kB, and needs larger ones for what others than we send to it.
//!
//! Creating a participant takes tens of milliseconds and two threads; reading and writing never
//! block. Everything here must be called inside a tokio runtime.

mod calls;
pub(crate) mod encoding;
mod graph;
mod intake;
mod matched;
mod misfit;
mod neighbours;
mod reader;
mod writer;

use std::{sync::Arc, time::Duration};

use ros_message::Library;
use rustdds::{DomainParticipant, DomainParticipantBuilder, GUID, QosPolicies, RTPSEntity, Topic, TopicKind};

use self::graph::Graph;
pub use self::{
    calls::{Caller, Client, Exchange, Number, Reply, Request, Server},
    matched::{Matched, Matching},
    neighbours::{Change, Neighbour, Role},
    reader::Reader,
    writer::Writer,
};
use crate::{
    door::Door,
    error::{Error, Explained, Result},
    mark::Mark,
    names::{TopicName, TypeName},
    qos::Qos,
    queue::Limits,
    reach::{Range, Reach},
};

/// How long others keep a participant that was killed. It announces itself five times in it.
pub(crate) const LEASE: Duration = Duration::from_secs(6);
/// How often a reader or writer looks whether DDS is still there.
const ALIVE_EVERY: Duration = Duration::from_secs(1);

/// Highest DDS domain: above it the UDP ports would exceed 65535.
pub const DOMAIN_MAX: u16 = 232;

/// Our presence in one ROS domain: a DDS participant with one ROS 2 node. Cloning shares it; it
/// leaves the domain when the last clone, reader and writer are gone.
#[derive(Clone)]
pub struct Participant {
    dds: DomainParticipant,
    graph: Arc<Graph>,
    /// Is every process that it hears on this host, with the same clock?
    is_alone: bool,
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
        let node = graph::node_name(node_name)?;
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
            let graph = Arc::new(Graph::announce(&dds, node)?);
            Ok(Self { dds, graph, is_alone })
        };
        let joined = tokio::task::spawn_blocking(join).await;
        joined.map_err(|error| dds_error(&format!("cannot join ROS domain {domain}"), &error))?
    }

    /// Starts to read a topic. Samples of this participant's own writers are never given out.
    pub fn reader(&self, topic: &TopicName, message: &TypeName, qos: &Qos, limits: Limits) -> Result<Reader> {
        Reader::open(self, topic, message, qos, limits, None)
    }

    /// Starts to read a topic whose samples go to the ledger: only what the door admits is given out. Other bridges
    /// see whose door it is.
    pub fn reader_behind(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        limits: Limits,
        door: Arc<Door>,
    ) -> Result<Reader> {
        Reader::open(self, topic, message, qos, limits, Some(door))
    }

    /// Starts to offer a topic.
    pub fn writer(&self, topic: &TopicName, message: &TypeName, qos: &Qos) -> Result<Writer> {
        Writer::open(self, topic, message, qos, None)
    }

    /// Starts to offer a topic with samples that come from the ledger. No bridge of that network takes them in.
    pub fn marked_writer(&self, topic: &TopicName, message: &TypeName, qos: &Qos, mark: Mark) -> Result<Writer> {
        Writer::open(self, topic, message, qos, Some(mark))
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
    fn with_type_hash(&self, policies: QosPolicies, message: &TypeName) -> QosPolicies {
        let computed = Library::builtin().message(&message.to_string()).ok().map(|message| message.type_hash());
        match computed.or_else(|| self.hash_in_graph(&message.dds())) {
            Some(hash) => policies.with_user_data(format!("typehash={hash};").into_bytes()),
            None => policies,
        }
    }

    fn guid_prefix(&self) -> [u8; 12] {
        prefix(self.dds.guid())
    }

    fn topic(&self, topic: &TopicName, message: &TypeName, qos: &Qos) -> Result<Topic> {
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

/// Bytes of a GUID that all endpoints of a participant share.
const PREFIX_BYTES: usize = 12;

/// The part of a GUID that all endpoints of a participant share.
fn prefix(guid: GUID) -> [u8; PREFIX_BYTES] {
    let mut prefix = [0; PREFIX_BYTES];
    prefix.iter_mut().zip(guid.to_bytes()).for_each(|(to, from)| *to = from);
    prefix
}

fn dds_error(what: &str, error: &dyn std::error::Error) -> Error {
    let wanted = "a working DDS participant";
    let hint = "look at the interfaces of this machine (`ip address`) and at its free UDP ports from 7400";
    Error::Dds(Explained::new(what, error.to_string(), wanted, hint))
}
