//! Connects a [`Participant`] to sockets, clocks and the tasks of tokio.
//!
//! ```text
//! Domain, DomainWriter, DomainReader   handles: the domain is left when the last one is dropped
//! membership   the participant behind a lock: steps it, and carries out its outputs
//! task         receives datagrams, and watches the deadline
//! sockets      opens sockets; send: sends, or lets datagrams wait for room
//! filter, sources   only this host and static peers, in the kernel and here
//! reports      which losses are logged, and how often
//! ```

mod filter;
mod matches;
mod membership;
mod queue;
mod reader;
mod reports;
mod send;
mod sockets;
mod sources;
mod task;
#[cfg(test)]
mod tests;
mod timer;
mod writer;

pub use matches::Matches;
pub use membership::Ended;
pub use queue::{Losses, QueueLimits, ReaderCounters};
pub use reader::DomainReader;
pub use writer::{DomainWriter, WriteError};

use crate::guid::{Guid, GuidPrefix, PREFIX_BYTES, VendorId};
use crate::interface::{Config, Counters, EndpointSettings, RemoteEndpoint, UnreachableParticipant};
use crate::participant::Participant;
use bytes::Bytes;
use membership::Membership;
use rustix::rand::{GetRandomFlags, getrandom};
use send::Senders;
use sockets::{Interfaces, ReceiveSockets, SendSockets};
use sources::Hosts;
use std::io::{self, ErrorKind};
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::Duration;
use task::Task;
use timer::Timer;
use tokio::sync::watch;
use tokio::task::spawn_blocking;

/// Largest ROS domain: above it participants have no ports.
const DOMAIN_MAX: u16 = 232;

/// How a domain is joined.
#[derive(Clone, Debug)]
pub struct DomainSettings {
    /// The ROS domain, 0 to 232.
    pub domain: u16,
    /// Exchange datagrams with processes of this host and with static peers only.
    pub only_local: bool,
    /// Addresses of the interfaces that are used; none = all.
    pub interfaces: Option<Vec<Ipv4Addr>>,
    /// Hosts that are asked without multicast.
    pub static_peers: Vec<Ipv4Addr>,
    /// How long others keep this participant after its last sign of life.
    pub lease: Duration,
    /// Name of the participant as tools show it.
    pub name: String,
    /// USER_DATA of the participant.
    pub user_data: Bytes,
}

/// A participant of a domain. Clones share it. It leaves the domain when the last clone, reader and writer are dropped.
///
/// It uses the interfaces and addresses of the moment when it joined. Where they change, join again.
#[derive(Clone, Debug)]
pub struct Domain {
    membership: Arc<Membership>,
    domain: u16,
}

impl Domain {
    /// Joins a domain, and starts a task for it.
    ///
    /// # Errors
    /// If the domain is out of range, all its unicast ports are in use, or a socket cannot be opened.
    pub async fn join(settings: DomainSettings) -> io::Result<Self> {
        let DomainSettings { domain, only_local, interfaces, static_peers, lease, name, user_data } = settings;
        if domain > DOMAIN_MAX {
            let why = format!("ROS domain {domain} is out of range: 0 to {}", DOMAIN_MAX);
            return Err(io::Error::new(ErrorKind::InvalidInput, why));
        }
        let peers = static_peers.clone();
        let open = move || {
            let interfaces = Interfaces::read(interfaces.as_deref());
            // Peers first: the filter compares a bounded number.
            let sources = [peers, interfaces.host.clone()].concat();
            let receivers = ReceiveSockets::open(domain, &interfaces.multicast, only_local.then_some(&*sources))?;
            let senders = SendSockets::open(&interfaces.multicast, only_local)?;
            io::Result::Ok((interfaces, receivers, senders))
        };
        let opened = spawn_blocking(open).await.map_err(io::Error::other)?;
        let (Interfaces { host, used, .. }, ReceiveSockets { channels, participant_id, has_multicast }, senders) =
            opened?;
        let config = Config {
            prefix: new_prefix()?,
            domain,
            participant_id,
            lease,
            addresses: used,
            host: host.clone(),
            static_peers: with_own_host(&static_peers),
            multicast: has_multicast,
            name,
            user_data,
        };
        tracing::debug!(domain, participant_id, prefix = %config.prefix, "joins a ROS domain");
        let timer = Arc::new(Timer::new()?);
        let hosts = Hosts::new(only_local, &host, &static_peers);
        let senders = Senders::new(senders, host, hosts.clone())?;
        let membership = Membership::new(Participant::new(config, timer::now()), senders, Arc::clone(&timer));
        let membership = Arc::new(membership);
        tokio::spawn(Task::new(&membership, timer, channels, hosts)?.run());
        // Sends the first announcement, and sets the timer.
        membership.fired().map_err(io::Error::other)?;
        Ok(Self { membership, domain })
    }

    /// The ROS domain.
    pub fn domain(&self) -> u16 {
        self.domain
    }

    /// The GUID of the participant: unique in the world, new with every start.
    pub fn guid(&self) -> Guid {
        self.membership.guid()
    }

    /// Opens a writer.
    ///
    /// # Errors
    /// If the domain has ended.
    pub fn writer(&self, settings: EndpointSettings) -> Result<DomainWriter, Ended> {
        DomainWriter::open(Arc::clone(&self.membership), settings)
    }

    /// Opens a reader. At most so many samples wait to be read; newer ones push out the oldest.
    ///
    /// # Errors
    /// If the domain has ended.
    pub fn reader(&self, settings: EndpointSettings, limits: QueueLimits) -> Result<DomainReader, Ended> {
        DomainReader::open(Arc::clone(&self.membership), settings, limits)
    }

    /// The writers of other participants, now. None after the end.
    pub fn publishers(&self) -> Vec<Arc<RemoteEndpoint>> {
        self.membership.discovered(|endpoint| endpoint.guid.entity.is_writer())
    }

    /// The readers of other participants, now. None after the end.
    pub fn subscribers(&self) -> Vec<Arc<RemoteEndpoint>> {
        self.membership.discovered(|endpoint| endpoint.guid.entity.is_reader())
    }

    /// The other participants that announce no address of UDP over IPv4: their endpoints are not found. None after the end. A change
    /// counts in [`Domain::changes`].
    pub fn unreachable(&self) -> Vec<UnreachableParticipant> {
        self.membership.unreachable()
    }

    /// This endpoint of another participant, if it is there now.
    pub fn endpoint(&self, guid: Guid) -> Option<Arc<RemoteEndpoint>> {
        self.membership.endpoint(guid)
    }

    /// Counts changes of the endpoints of other participants. Closed when the domain ends.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.membership.changes()
    }

    /// How many datagrams were not sent so far, because the network was too slow or not there.
    ///
    /// # Errors
    /// If the domain has ended.
    pub fn unsent(&self) -> Result<u64, Ended> {
        self.membership.unsent()
    }

    /// Counts of what was rejected and ignored so far.
    ///
    /// # Errors
    /// If the domain has ended.
    pub fn counters(&self) -> Result<Counters, Ended> {
        self.membership.counters()
    }

    /// Ends the domain as a fault would: others are not notified, and all handles report it. For tests.
    pub fn end(&self) {
        self.membership.end();
    }
}

/// Random, so that no two participants have the same. It begins with the vendor (§9.3.1.5).
fn new_prefix() -> io::Result<GuidPrefix> {
    let mut prefix = [0; PREFIX_BYTES];
    let [first, second, random @ ..] = &mut prefix;
    [*first, *second] = VendorId::OWN.0;
    getrandom(random, GetRandomFlags::empty())?;
    Ok(GuidPrefix(prefix))
}

/// Participants of this host are asked one by one as well: a loopback interface may be all there is, and has no multicast in most
/// systems. CycloneDDS and Fast DDS that are set to the loopback without multicast expect it.
fn with_own_host(peers: &[Ipv4Addr]) -> Vec<Ipv4Addr> {
    let mut all = vec![Ipv4Addr::LOCALHOST];
    all.extend(peers.iter().filter(|peer| !peer.is_loopback()));
    all
}
