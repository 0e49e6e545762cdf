//! Inputs and outputs of the state machine.

use crate::guid::{EntityId, Guid, GuidPrefix, SampleIdentity, SequenceNumber, VendorId};
use crate::qos::{Policy, Qos};
use crate::time::Ticks;
use bytes::Bytes;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

/// The settings of a participant. None of them changes.
#[derive(Clone, Debug)]
pub struct Config {
    /// Unique in the world, new with every start.
    pub prefix: GuidPrefix,
    /// The ROS domain, 0 to 232.
    pub domain: u16,
    /// Number of this participant among those of its host: its unicast ports follow from it (§9.6.1.1).
    pub participant_id: u16,
    /// How long others keep this participant after its last sign of life. It announces itself five times in it.
    pub lease: Duration,
    /// The addresses under which others reach it.
    pub addresses: Vec<Ipv4Addr>,
    /// The addresses of this host: peers there get large datagrams.
    pub host: Vec<Ipv4Addr>,
    /// Peers that are asked without multicast: `ROS_STATIC_PEERS`, and the own host where multicast is not available.
    pub static_peers: Vec<Ipv4Addr>,
    /// Announce by multicast?
    pub multicast: bool,
    /// Name of the participant as tools show it.
    pub name: String,
    /// USER_DATA of the participant: `enclave=/;`.
    pub user_data: Bytes,
}

/// A topic as an endpoint names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicDescription {
    /// `rt/cmd_vel`.
    pub name: String,
    /// `geometry_msgs::msg::dds_::Twist_`.
    pub type_name: String,
    /// Are instances told apart by a key?
    pub keyed: bool,
}

/// The settings of an own endpoint.
#[derive(Clone, Debug)]
pub struct EndpointSettings {
    /// Its topic.
    pub topic: TopicDescription,
    /// Offered or requested.
    pub qos: Qos,
    /// `typehash=RIHS01_…;` and other keys of ROS 2.
    pub user_data: Bytes,
    /// Readers only: samples from before the match are not delivered, whatever the writer keeps. By sequence numbers, these are all
    /// up to the last one of the writer's first HEARTBEAT, unless they came before it.
    pub without_history: bool,
}

/// A sample to be written.
#[derive(Clone, Debug)]
pub struct OutgoingSample {
    /// Encapsulation header and serialized data.
    pub payload: Bytes,
    /// When it was made; travels as INFO_TS.
    pub timestamp: Option<Ticks>,
    /// The request to which it replies.
    pub related: Option<SampleIdentity>,
}

/// A sample that was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IncomingSample {
    /// The writer.
    pub writer: Guid,
    /// Its number.
    pub sequence: SequenceNumber,
    /// When it was made, as its writer says.
    pub timestamp: Option<Ticks>,
    /// The request to which it replies.
    pub related: Option<SampleIdentity>,
    /// Encapsulation header and serialized data.
    pub payload: Bytes,
}

/// An endpoint of another participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteEndpoint {
    /// Its identifier.
    pub guid: Guid,
    /// Of which implementation.
    pub vendor: VendorId,
    /// Its topic.
    pub topic: TopicDescription,
    /// Offered or requested.
    pub qos: Qos,
    /// Its USER_DATA.
    pub user_data: Bytes,
    /// Can it be reached by UDP over IPv4?
    pub is_reachable: bool,
}

/// A participant of others that announces no address of UDP over IPv4 for discovery: Fast DDS with TCP or shared memory alone
/// (`LARGE_DATA`), or a host with IPv6 alone. Its endpoints are not found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnreachableParticipant {
    /// Its identifier.
    pub guid: Guid,
    /// Of which implementation.
    pub vendor: VendorId,
    /// The host from which it announced itself last.
    pub host: Ipv4Addr,
}

/// The socket by which a datagram came, or from which it goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Channel {
    /// Discovery by multicast.
    DiscoveryMulticast,
    /// Discovery by unicast.
    DiscoveryUnicast,
    /// Samples by multicast.
    DataMulticast,
    /// Samples by unicast.
    DataUnicast,
}

/// An event or a command for a participant.
#[derive(Clone, Debug)]
pub enum Input {
    /// A datagram has come.
    Datagram {
        /// Its sender.
        from: SocketAddrV4,
        /// By which socket.
        channel: Channel,
        /// The datagram.
        bytes: Bytes,
    },
    /// Time has passed, or reached [`Participant::deadline`](crate::Participant::deadline).
    Time,
    /// Open a writer. Answered by [`Output::Opened`].
    OpenWriter(EndpointSettings),
    /// Open a reader. Answered by [`Output::Opened`].
    OpenReader(EndpointSettings),
    /// Close an own endpoint.
    Close(EntityId),
    /// Write a sample. Answered by [`Output::Written`].
    Write {
        /// The own writer.
        writer: EntityId,
        /// The sample.
        sample: OutgoingSample,
    },
    /// Assert the liveliness of an own writer of kind MANUAL_BY_TOPIC or MANUAL_BY_PARTICIPANT, as writing does.
    AssertLiveliness(EntityId),
    /// Leave the domain, and announce that to others.
    Leave,
}

/// An action that a participant requests, or a report.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Send a datagram to each of these addresses. Losing it is allowed.
    Send {
        /// The addresses.
        to: Vec<SocketAddrV4>,
        /// The datagram.
        bytes: Bytes,
    },
    /// The endpoint that was asked for is open. In the order of the commands.
    Opened(EntityId),
    /// The sample has this number.
    Written {
        /// The own writer.
        writer: EntityId,
        /// The number.
        sequence: SequenceNumber,
    },
    /// An own reader has a sample.
    Sample {
        /// The own reader.
        reader: EntityId,
        /// The sample.
        sample: IncomingSample,
    },
    /// An endpoint matches an own one. Before its first sample.
    Matched {
        /// The own endpoint.
        endpoint: EntityId,
        /// The other one.
        other: Guid,
    },
    /// A match has ended.
    Unmatched {
        /// The own endpoint.
        endpoint: EntityId,
        /// The other one.
        other: Guid,
    },
    /// An endpoint of the same topic does not fit an own one.
    Incompatible {
        /// The own endpoint.
        endpoint: EntityId,
        /// The other one.
        other: Guid,
        /// Why.
        policy: Policy,
    },
    /// Samples of a writer will not be delivered.
    Lost {
        /// The own reader.
        reader: EntityId,
        /// The writer.
        writer: Guid,
        /// How many.
        count: u64,
        /// Why.
        reason: LossReason,
    },
    /// The numbers of a writer stayed below those that it seemed to have passed: they began again, or others were sent in its name. Its
    /// samples are delivered again. Worth a warning.
    Resynchronized {
        /// The own reader, of an application or built in.
        reader: EntityId,
        /// The writer.
        writer: Guid,
    },
    /// The liveliness of a matched writer has ended, or begun again.
    Liveliness {
        /// The own reader.
        reader: EntityId,
        /// The writer.
        writer: Guid,
        /// Is it alive now? It is when it matches, unless this is said at once.
        is_alive: bool,
    },
    /// No sample of any writer came within the deadline that a reader requests.
    DeadlineMissed {
        /// The own reader.
        reader: EntityId,
        /// How many times since this was reported last.
        count: u64,
    },
    /// All reliable readers have everything that was written. Said once after each time that this becomes true.
    Acknowledged(EntityId),
    /// A participant has announced itself that cannot be reached.
    Unreachable(UnreachableParticipant),
    /// A participant that could not be reached can be reached now, or has gone.
    NotUnreachable(Guid),
    /// An endpoint of another participant has come, or has changed.
    Found(Box<RemoteEndpoint>),
    /// An endpoint of another participant has gone.
    Gone(Guid),
}

/// Why samples are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LossReason {
    /// The writer is reliable and has them no more: a GAP or HEARTBEAT says so.
    Gone,
    /// Larger than [`crate::limits::SAMPLE_BYTES_MAX`].
    TooLarge,
    /// There was no room for fragments.
    NoRoom,
    /// A best-effort sample did not come.
    BestEffort,
    /// Fragments of a best-effort sample did not come, before the next sample or within
    /// [`crate::limits::ASSEMBLY_MICROS_MAX`].
    Incomplete,
}

impl LossReason {
    /// Its words, for a log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gone => "the writer has dropped them",
            Self::TooLarge => "they are too large",
            Self::NoRoom => "no room for fragments",
            Self::BestEffort => "best effort",
            Self::Incomplete => "best effort, fragments are missing",
        }
    }

    /// May such a loss happen without a fault, because the policies promise no repair?
    pub fn is_best_effort(self) -> bool {
        matches!(self, Self::BestEffort | Self::Incomplete)
    }
}

/// Samples that left the history of an own writer before all reliable readers had them, or before they were sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriterLosses {
    /// Newer ones replaced them within the depth of KEEP_LAST, as the policy says.
    pub replaced: u64,
    /// [`crate::limits::HISTORY_BYTES_MAX`] or [`crate::limits::HISTORY_SAMPLES_MAX`] left no room for them. KEEP_ALL promises them.
    pub pushed_out: u64,
}

/// Counts of what a participant has rejected and ignored since it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Datagrams of which the rest, or all, was dropped as malformed.
    pub malformed: u64,
    /// Announcements that cannot be read, or that name participants and endpoints of others.
    pub announcements_rejected: u64,
    /// Announcements of participants and endpoints beyond the limits of their number or size.
    pub beyond_limits: u64,
    /// Samples and fragments that were sent to this participant by writers that no reader matches. A few are usual: a writer may match
    /// first.
    pub unknown_writers: u64,
    /// How often the numbers of writers began again: see [`Output::Resynchronized`].
    pub resynchronized: u64,
}
