//! The content of datagrams, as it was read and before it is written.

use crate::guid::{EntityId, GuidPrefix, SampleIdentity, SequenceNumber};
use crate::time::Ticks;
use bytes::Bytes;

/// A set of sequence numbers: from `base` on, at most 256 (§9.4.2.6).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NumberSet {
    /// The first number that can be in the set. Everything below is not in it.
    pub base: i64,
    /// How many numbers the set covers, at most [`crate::limits::SET_BITS_MAX`].
    pub bits: u32,
    /// One bit for each, the most significant of the first word first.
    pub bitmap: [u32; 8],
}

/// The content of a sample or of its key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Payload {
    /// Nothing: the inline QoS says what happened.
    None,
    /// A sample: encapsulation header (representation, options) and serialized data.
    Data(Bytes),
    /// A key: of a sample that is disposed of or unregistered.
    Key(Bytes),
}

/// The parameters in front of a sample that count here (§9.6.4).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct InlineQos {
    /// `PID_RELATED_SAMPLE_IDENTITY` (0x0083), or Fast DDS's own number for the same (0x800f).
    pub related: Option<SampleIdentity>,
    /// `PID_STATUS_INFO`: bit 0 disposed, bit 1 unregistered.
    pub status: u32,
    /// `PID_KEY_HASH`.
    pub key_hash: Option<[u8; 16]>,
}

/// DATA (§8.3.8.2): a sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Data {
    /// For this reader, or for all that match.
    pub reader: EntityId,
    /// The writer in the source participant.
    pub writer: EntityId,
    /// The number of the sample.
    pub sequence: SequenceNumber,
    /// Its parameters.
    pub inline_qos: InlineQos,
    /// Its content.
    pub payload: Payload,
}

/// DATA_FRAG (§8.3.8.3): consecutive fragments of a sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DataFrag {
    /// For this reader, or for all that match.
    pub reader: EntityId,
    /// The writer in the source participant.
    pub writer: EntityId,
    /// The number of the sample.
    pub sequence: SequenceNumber,
    /// The number of the first fragment in this submessage. The first of a sample is 1.
    pub first: u32,
    /// How many fragments are in this submessage.
    pub count: u16,
    /// Bytes of each fragment but the last one of the sample.
    pub fragment_bytes: u16,
    /// Bytes of the whole sample, with its encapsulation header.
    pub sample_bytes: u32,
    /// The parameters of the sample.
    pub inline_qos: InlineQos,
    /// Is it the fragment of a key?
    pub is_key: bool,
    /// The fragments.
    pub payload: Bytes,
}

/// HEARTBEAT (§8.3.8.6): which samples a writer has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// For this reader, or for all that match.
    pub reader: EntityId,
    /// The writer in the source participant.
    pub writer: EntityId,
    /// The oldest sample.
    pub first: SequenceNumber,
    /// The newest sample; below `first` if there is none.
    pub last: SequenceNumber,
    /// Grows with each heartbeat.
    pub count: i32,
    /// No answer is wanted if nothing is missing.
    pub is_final: bool,
    /// The writer asserts that it is alive.
    pub is_alive: bool,
}

/// HEARTBEAT_FRAG (§8.3.8.7): which fragments of a sample a writer has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeartbeatFrag {
    /// For this reader, or for all that match.
    pub reader: EntityId,
    /// The writer in the source participant.
    pub writer: EntityId,
    /// The sample.
    pub sequence: SequenceNumber,
    /// Its newest fragment that can be had.
    pub last: u32,
    /// Grows with each.
    pub count: i32,
}

/// ACKNACK (§8.3.8.1): what a reader has, and what it lacks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AckNack {
    /// The reader in the source participant.
    pub reader: EntityId,
    /// The writer in the destination participant.
    pub writer: EntityId,
    /// All below the base have come or are given up; those in the set are requested.
    pub missing: NumberSet,
    /// Grows with each.
    pub count: i32,
    /// No heartbeat is wanted.
    pub is_final: bool,
}

/// NACK_FRAG (§8.3.8.10): the fragments of a sample that a reader lacks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NackFrag {
    /// The reader in the source participant.
    pub reader: EntityId,
    /// The writer in the destination participant.
    pub writer: EntityId,
    /// The sample.
    pub sequence: SequenceNumber,
    /// The requested fragments.
    pub missing: NumberSet,
    /// Grows with each.
    pub count: i32,
}

/// GAP (§8.3.8.4): samples that will not come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// For this reader, or for all that match.
    pub reader: EntityId,
    /// The writer in the source participant.
    pub writer: EntityId,
    /// The first of them. All from here to below the base of `list` will not come.
    pub start: SequenceNumber,
    /// More of them.
    pub list: NumberSet,
}

/// A submessage of an endpoint. Where it comes from, for whom it is, and its time stand beside it ([`Addressed`]).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Submessage {
    /// A sample.
    Data(Data),
    /// Fragments of a sample.
    DataFrag(DataFrag),
    /// Which samples a writer has.
    Heartbeat(Heartbeat),
    /// Which fragments of a sample a writer has.
    HeartbeatFrag(HeartbeatFrag),
    /// The samples that a reader has and lacks.
    AckNack(AckNack),
    /// Which fragments of a sample a reader lacks.
    NackFrag(NackFrag),
    /// Samples that will not come.
    Gap(Gap),
}

/// A submessage with what the header and INFO submessages before it said (§8.3.4).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Addressed {
    /// The participant that sends it.
    pub source: GuidPrefix,
    /// The participant for which it is; [`GuidPrefix::UNKNOWN`] for all.
    pub destination: GuidPrefix,
    /// INFO_TS; none if it was absent or said that there is none.
    pub timestamp: Option<Ticks>,
    /// The submessage.
    pub submessage: Submessage,
}
