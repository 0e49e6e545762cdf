//! Types that readers and writers share: the other side of a match, and what they want sent.

use crate::guid::{Guid, GuidPrefix};
use crate::interface::{IncomingSample, LossReason};
use crate::time::Ticks;
use crate::wire::submessage::Submessage;
use std::net::SocketAddrV4;

/// The other side of a match.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Peer {
    /// Its identifier.
    pub(crate) guid: Guid,
    /// Does it ask for repair, or offer it?
    pub(crate) is_reliable: bool,
    /// Does it want, or keep, samples from before the match?
    pub(crate) is_durable: bool,
    /// Where it is reached by unicast; never empty.
    pub(crate) unicast: Vec<SocketAddrV4>,
    /// Is it on this host? Then fragments are large.
    pub(crate) is_local: bool,
    /// Is it of Fast DDS? It ignores ACKNACKs whose count or base goes back, and a count of 0.
    pub(crate) is_fast_dds: bool,
}

/// Submessages for one or more participants. The participant packs them into datagrams.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Outgoing {
    /// The addresses.
    pub(crate) to: Vec<SocketAddrV4>,
    /// The participant for which they are; [`GuidPrefix::UNKNOWN`] where it is for all.
    pub(crate) destination: GuidPrefix,
    /// INFO_TS in front of them.
    pub(crate) timestamp: Option<Ticks>,
    /// In this order.
    pub(crate) submessages: Vec<Submessage>,
}

/// The results of a reader.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Delivered {
    /// A sample.
    Sample(IncomingSample),
    /// An instance was disposed of or unregistered (`status` as in PID_STATUS_INFO). `key`: the serialized key or data with its
    /// encapsulation header, or the key hash.
    Disposed { writer: Guid, key: DisposedKey },
    /// Samples will not come.
    Lost { writer: Guid, count: u64, reason: LossReason },
    /// The numbers of a writer stayed below those that it seemed to have passed: its messages were forged. Its samples are delivered
    /// again. Worth a warning.
    Resynchronized { writer: Guid },
    /// No sample came within the deadline, this many times since this was reported last.
    DeadlineMissed { count: u64 },
}

/// Which instance was disposed of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DisposedKey {
    /// `PID_KEY_HASH`.
    Hash([u8; 16]),
    /// The serialized key, with its encapsulation header.
    Serialized(bytes::Bytes),
    /// It does not say.
    Unknown,
}
