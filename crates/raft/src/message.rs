//! Messages between nodes about ordering, in our own protobuf types.
//!
//! ```text
//! message PeerMessage {
//!   oneof kind { Raft raft = 1; Transactions forward = 2; Transactions returned = 3; Behind behind = 4; Statement statement = 6;
//!                Mandate mandate = 7; MandateWanted mandate_wanted = 8; Early early = 9; Head head = 10;
//!                Evidence evidence = 14; }
//! }
//! message Raft {
//!   uint32 kind        = 1;   // RaftKind; there is no 0
//!   uint64 term        = 2;   // 1 or more, except in read_index
//!   uint64 log_term    = 3;   // append: term of the entry before the first; votes: of the last
//!   uint64 index       = 4;   // append: the entry before the first; responses: the last that matches
//!   uint64 commit      = 5;   // what the sender knows to be committed
//!   uint64 commit_term = 6;   // term of that entry, in votes
//!   bool   reject      = 7;   // responses: refused
//!   uint64 reject_hint = 8;   // append_response: where the logs may still agree
//!   bytes  context     = 9;   // heartbeats and reads: names the reads that wait; vote: a transfer of leadership
//!   repeated Entry entries = 10;   // append only
//!   uint64 receipt_index = 11; // heartbeat: a block that the receiver has acknowledged in this term
//!   bytes  receipt     = 12;  // append_response: a code over its index; heartbeat: the receiver's own code
//!   uint64 accepts_until = 13; // responses to append and heartbeat: the latest block time that the sender acknowledges
//!   bytes  vote        = 14;  // vote_response that grants: the signature of the vote
//!   bytes  hash        = 15;  // append: of the chain up to `index`; append_response that acknowledges: the same of the sender
//!   bytes  transfer    = 16;  // timeout_now, and the vote that follows from it: the leader's signature that it hands over
//!   bytes  head        = 17;  // append: the leader's signature over its log up to the last entry
//! }
//! message Entry { uint64 index = 1; uint64 term = 2; uint32 kind = 3; bytes data = 4; }   // kind: 1 block, 3 members
//! message Statement { bytes signed = 1; }                     // see ledger-light; not for the engine
//! message Mandate { uint64 term = 1; repeated SignedVote votes = 2; }   // in ascending order of nodes
//! message SignedVote { uint64 node = 1; bytes signed = 2; }   // the vote of that node for the sender; see ledger-light
//! message MandateWanted { uint64 term = 1; }                  // to a node that speaks as a leader: show your mandate
//! message Head { uint64 term = 1; uint64 leader = 2; uint64 height = 3; bytes hash = 4;   // the newest that the sender has checked
//!                bytes signature = 5; bytes vote = 6; }      // the vote of the leader for itself, which has its certificate
//! message Evidence { bytes proof = 1; }                       // see ledger-light; not for the engine
//! message Early { bytes transaction = 1; }                    // a signed call that robots hear of before it is ordered; not for the engine
//! message Transactions { repeated bytes control = 1; repeated bytes data = 2; uint32 code = 3; }
//! ```
//! Sender and receiver are not in the message: they are the two ends of an authenticated connection. Messages that the
//! engine could also send, but that must not come from a peer, have no number: proposals, transfers, snapshots, local
//! events.

pub(crate) mod convert;

use bytes::Bytes;
use ledger::block::{PAYLOAD_BYTES_MAX, TRANSACTIONS_MAX};
use ledger::members::NODES_MAX;
use ledger_storage::entry::EntryKind;
use prost::Message as _;
use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

/// Longest message between nodes: one full block and its framing. Longer batches are cut by the sender.
pub const PEER_MESSAGE_BYTES_MAX: usize = PAYLOAD_BYTES_MAX + TRANSACTIONS_MAX * 8 + 64 * 1024;
/// Most entries in one message. Bounds what a message of many empty entries costs in memory.
pub const ENTRIES_MAX: usize = 1024;
/// Longest context: names of reads and transfers are shorter.
pub const CONTEXT_BYTES_MAX: usize = 64;
/// Length of the hash of a chain.
pub(crate) const HASH_BYTES: usize = 32;
/// Length of a receipt.
pub(crate) const RECEIPT_BYTES: usize = 32;
/// Longest signed statement in a message: the certificate of a node (16 KiB), and what is around it.
pub const STATEMENT_BYTES_MAX: usize = 17 * 1024;
/// Longest proof of misbehaviour in a message.
pub const EVIDENCE_BYTES_MAX: usize = ledger_light::lie::MISBEHAVIOUR_BYTES_MAX;
/// Longest call of which robots hear before it is ordered: a stop with its reason, and the certificate of its creator (16 KiB).
pub const EARLY_BYTES_MAX: usize = 32 * 1024;
/// Longest signature of a vote in a message: the certificate of a node (16 KiB), and what is around it.
pub const VOTE_BYTES_MAX: usize = 17 * 1024;
/// Longest signature of a head in a message.
pub const HEAD_BYTES_MAX: usize = 128;
/// Largest term. Leaves room to count on without overflow after a hostile peer named one.
const TERM_MAX: u64 = 1 << 62;
/// Most fields in a message: every repeated one at its limit, and the others.
const FIELDS_MAX: usize = ENTRIES_MAX + TRANSACTIONS_MAX + 16;

const _: () = assert!(NODES_MAX * (VOTE_BYTES_MAX + 32) < PEER_MESSAGE_BYTES_MAX);

/// A message between two nodes.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum PeerMessage {
    /// Raft.
    #[prost(message, tag = "1")]
    Raft(RaftMessage),
    /// To the leader: please order these.
    #[prost(message, tag = "2")]
    Forward(Transactions),
    /// From the leader, or from a node that is not the leader any more: these were not ordered.
    #[prost(message, tag = "3")]
    Returned(Transactions),
    /// From the leader: what you need next was dropped here; fetch it from whoever has it.
    #[prost(message, tag = "4")]
    Behind(LogBegin),
    /// To all members: what executing a block gave, signed by the sender, or by another voter that contradicts others. Not
    /// about ordering, so not for the engine.
    #[prost(message, tag = "6")]
    Statement(SignedStatement),
    /// From a leader: a majority has elected me in this term.
    #[prost(message, tag = "7")]
    Mandate(Mandate),
    /// To a node that speaks as a leader: show your mandate.
    #[prost(message, tag = "8")]
    MandateWanted(MandateWanted),
    /// To all members: robots are to hear of this call before it is ordered. Not about ordering, so not for the engine.
    #[prost(message, tag = "9")]
    Early(EarlyCall),
    /// From a voter that follows to the others: the newest head that it has checked.
    #[prost(message, tag = "10")]
    Head(LeaderHead),
    /// To all members: the proof that a node has signed two different things for one place. Not about ordering, so not for
    /// the engine.
    #[prost(message, tag = "14")]
    Evidence(Evidence),
}

impl PeerMessage {
    /// Does it bring entries to append?
    pub fn brings_entries(&self) -> bool {
        matches!(self, Self::Raft(message) if !message.entries.is_empty())
    }
}

#[derive(Clone, PartialEq, prost::Message)]
struct Envelope {
    #[prost(oneof = "PeerMessage", tags = "1, 2, 3, 4, 6, 7, 8, 9, 10, 14")]
    kind: Option<PeerMessage>,
}

/// Where the sender's log begins.
#[derive(Clone, Copy, PartialEq, Eq, prost::Message)]
pub struct LogBegin {
    /// Height of its oldest block.
    #[prost(uint64, tag = "1")]
    pub first_index: u64,
}

/// A statement about a block with the signature of a voter, as `ledger-light` encodes it.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct SignedStatement {
    /// Its bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub signed: Bytes,
}

/// The proof that a node has signed two different things for one place, as `ledger-light` encodes it.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Evidence {
    /// Its bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub proof: Bytes,
}

/// A signed call that was submitted at the sender.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct EarlyCall {
    /// Its bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub transaction: Bytes,
}

/// The signed votes that have made the sender the leader of a term.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Mandate {
    /// The term.
    #[prost(uint64, tag = "1")]
    pub term: u64,
    /// In ascending order of nodes.
    #[prost(message, repeated, tag = "2")]
    pub votes: Vec<SignedVote>,
}

/// A vote with the signature of the voter.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct SignedVote {
    /// The voter.
    #[prost(uint64, tag = "1")]
    pub node: u64,
    /// The signature, as `ledger-light` encodes it.
    #[prost(bytes = "bytes", tag = "2")]
    pub signed: Bytes,
}

/// A member lacks the mandate of the leader of a term.
#[derive(Clone, Copy, PartialEq, Eq, prost::Message)]
pub struct MandateWanted {
    /// The term.
    #[prost(uint64, tag = "1")]
    pub term: u64,
}

/// A signed head of a leader, shown by a voter that follows it.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct LeaderHead {
    /// The leader's term.
    #[prost(uint64, tag = "1")]
    pub term: u64,
    /// The leader.
    #[prost(uint64, tag = "2")]
    pub leader: u64,
    /// Height of the last entry.
    #[prost(uint64, tag = "3")]
    pub height: u64,
    /// Hash of the chain up to it.
    #[prost(bytes = "bytes", tag = "4")]
    pub hash: Bytes,
    /// The leader's signature.
    #[prost(bytes = "bytes", tag = "5")]
    pub signature: Bytes,
    /// The vote of the leader for itself, with the certificate of the signature.
    #[prost(bytes = "bytes", tag = "6")]
    pub vote: Bytes,
}

/// Transactions on their way to the leader, or back.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Transactions {
    /// Of the control lane.
    #[prost(bytes = "bytes", repeated, tag = "1")]
    pub control: Vec<Bytes>,
    /// Of the data lane.
    #[prost(bytes = "bytes", repeated, tag = "2")]
    pub data: Vec<Bytes>,
    /// Returned only: the number of the [`ledger_base::rejection::Code`] that says why.
    #[prost(uint32, tag = "3")]
    pub code: u32,
}

/// A message of Raft; which fields count depends on its kind.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct RaftMessage {
    /// Its kind.
    #[prost(enumeration = "RaftKind", tag = "1")]
    pub kind: i32,
    /// The sender's term.
    #[prost(uint64, tag = "2")]
    pub term: u64,
    /// Term of the entry at `index`, or of the last entry.
    #[prost(uint64, tag = "3")]
    pub log_term: u64,
    /// The entry that the message is about.
    #[prost(uint64, tag = "4")]
    pub index: u64,
    /// The commit index that the sender knows.
    #[prost(uint64, tag = "5")]
    pub commit: u64,
    /// Term of the entry at `commit`.
    #[prost(uint64, tag = "6")]
    pub commit_term: u64,
    /// A response that refuses.
    #[prost(bool, tag = "7")]
    pub reject: bool,
    /// Where the logs may still agree.
    #[prost(uint64, tag = "8")]
    pub reject_hint: u64,
    /// Names reads, or a transfer.
    #[prost(bytes = "bytes", tag = "9")]
    pub context: Bytes,
    /// The entries after `index`.
    #[prost(message, repeated, tag = "10")]
    pub entries: Vec<WireEntry>,
    /// Heartbeats: the block that the receipt is for; 0 without one.
    #[prost(uint64, tag = "11")]
    pub receipt_index: u64,
    /// A receipt of what was acknowledged, for whoever made it.
    #[prost(bytes = "bytes", tag = "12")]
    pub receipt: Bytes,
    /// Responses to append and heartbeat: the latest block time that the sender acknowledges, microseconds since the UNIX epoch.
    #[prost(uint64, tag = "13")]
    pub accepts_until: u64,
    /// A vote that is granted: its signature, as `ledger-light` encodes it.
    #[prost(bytes = "bytes", tag = "14")]
    pub vote: Bytes,
    /// Append, and responses that acknowledge: hash of the sender's chain up to `index`.
    #[prost(bytes = "bytes", tag = "15")]
    pub hash: Bytes,
    /// Hand-over, and the request for a vote that follows from it: the signature of the leader that hands over.
    #[prost(bytes = "bytes", tag = "16")]
    pub transfer: Bytes,
    /// Append: the leader's signature of the head, which is its log up to the last entry.
    #[prost(bytes = "bytes", tag = "17")]
    pub head: Bytes,
}

/// An entry on the wire.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct WireEntry {
    /// Its height.
    #[prost(uint64, tag = "1")]
    pub index: u64,
    /// Its term.
    #[prost(uint64, tag = "2")]
    pub term: u64,
    /// The code of its [`EntryKind`].
    #[prost(uint32, tag = "3")]
    pub kind: u32,
    /// Its content.
    #[prost(bytes = "bytes", tag = "4")]
    pub data: Bytes,
}

/// The kinds of Raft messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub enum RaftKind {
    /// No message; never sent.
    Unspecified = 0,
    /// Leader: here are entries, and what is committed.
    Append = 1,
    /// Answer to it.
    AppendResponse = 2,
    /// Leader: I am here.
    Heartbeat = 3,
    /// Answer to it.
    HeartbeatResponse = 4,
    /// Candidate: vote for me.
    Vote = 5,
    /// Answer to it.
    VoteResponse = 6,
    /// Would you vote for me? Disturbs nobody.
    PreVote = 7,
    /// Answer to it.
    PreVoteResponse = 8,
    /// Leader: stand for election now, I hand over.
    TimeoutNow = 9,
    /// How far must I be to answer a read?
    ReadIndex = 10,
    /// Leader: this far.
    ReadIndexResponse = 11,
}

/// Why bytes are no message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// Longer than any message can be.
    #[error("message of a peer is too large: found {found} {unit}, wanted at most {max}")]
    TooLarge {
        /// How many.
        found: usize,
        /// How many are allowed.
        max: usize,
        /// Of what.
        unit: &'static str,
    },
    /// Not in the format, or of an unknown kind.
    #[error("message of a peer cannot be read: {0}")]
    Malformed(String),
}

impl PeerMessage {
    /// The bytes on the wire.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = Vec::with_capacity(self.encoded_len());
        self.encode(&mut bytes);
        bytes.into()
    }

    /// Reads a message. The content of entries and transactions is not copied. Never panics; allocates a small
    /// multiple of the input, whatever the input.
    ///
    /// # Errors
    /// [`MessageError`] if the bytes are not exactly one message within its limits.
    pub fn decode(bytes: Bytes) -> Result<Self, MessageError> {
        check_shape(&bytes)?;
        let envelope = Envelope::decode(bytes).map_err(|error| MessageError::Malformed(error.to_string()))?;
        let message = envelope.kind.ok_or_else(|| MessageError::Malformed("unknown kind".to_owned()))?;
        message.check()?;
        Ok(message)
    }

    fn check(&self) -> Result<(), MessageError> {
        match self {
            Self::Raft(raft) => raft.check(),
            Self::Forward(sent) | Self::Returned(sent) => {
                limit(sent.control.len() + sent.data.len(), TRANSACTIONS_MAX, "transactions")
            }
            Self::Behind(_) | Self::MandateWanted(_) => Ok(()),
            Self::Mandate(mandate) => mandate.check(),
            Self::Statement(statement) => limit(statement.signed.len(), STATEMENT_BYTES_MAX, "bytes of a statement"),
            Self::Head(head) => head.check(),
            Self::Evidence(evidence) => limit(evidence.proof.len(), EVIDENCE_BYTES_MAX, "bytes of a proof"),
            Self::Early(call) => limit(call.transaction.len(), EARLY_BYTES_MAX, "bytes of a call"),
        }
    }
}

impl Mandate {
    fn check(&self) -> Result<(), MessageError> {
        limit(self.votes.len(), NODES_MAX, "votes")?;
        let longest = self.votes.iter().map(|vote| vote.signed.len()).max();
        limit(longest.unwrap_or(0), VOTE_BYTES_MAX, "bytes of a vote")?;
        if self.term > TERM_MAX || !self.votes.is_sorted_by(|one, next| one.node < next.node) {
            return Err(MessageError::Malformed("votes out of order, or a term out of range".to_owned()));
        }
        Ok(())
    }
}

impl LeaderHead {
    fn check(&self) -> Result<(), MessageError> {
        limit(self.hash.len(), HASH_BYTES, "bytes of a hash")?;
        limit(self.signature.len(), HEAD_BYTES_MAX, "bytes of a head")?;
        limit(self.vote.len(), VOTE_BYTES_MAX, "bytes of a vote")?;
        if self.term > TERM_MAX { Err(MessageError::Malformed("term out of range".to_owned())) } else { Ok(()) }
    }
}

impl RaftMessage {
    fn check(&self) -> Result<(), MessageError> {
        limit(self.entries.len(), ENTRIES_MAX, "entries")?;
        limit(self.context.len(), CONTEXT_BYTES_MAX, "bytes of context")?;
        limit(self.receipt.len(), RECEIPT_BYTES, "bytes of a receipt")?;
        limit(self.vote.len(), VOTE_BYTES_MAX, "bytes of a vote")?;
        limit(self.hash.len(), HASH_BYTES, "bytes of a hash")?;
        limit(self.transfer.len(), VOTE_BYTES_MAX, "bytes of a transfer")?;
        limit(self.head.len(), HEAD_BYTES_MAX, "bytes of a head")?;
        let malformed = |what: &str| Err(MessageError::Malformed(what.to_owned()));
        let kind = match RaftKind::try_from(self.kind) {
            Ok(RaftKind::Unspecified) | Err(_) => return malformed("unknown kind of Raft message"),
            Ok(kind) => kind,
        };
        if (self.term == 0) != (kind == RaftKind::ReadIndex) || self.term > TERM_MAX {
            return malformed("term out of range");
        }
        if !self.entries.is_empty() && kind != RaftKind::Append {
            return malformed("entries in a message that carries none");
        }
        let (mut index, mut term) = (self.index, self.log_term);
        for entry in &self.entries {
            let known = u8::try_from(entry.kind).ok().and_then(EntryKind::from_code);
            if known.is_none() {
                return malformed("unknown kind of entry");
            }
            if Some(entry.index) != index.checked_add(1) || entry.term < term || entry.term > self.term {
                return malformed("entries do not follow each other");
            }
            (index, term) = (entry.index, entry.term);
        }
        Ok(())
    }
}

fn limit(found: usize, max: usize, unit: &'static str) -> Result<(), MessageError> {
    if found > max { Err(MessageError::TooLarge { found, max, unit }) } else { Ok(()) }
}

/// Counts fields without allocating: decoding allocates per element, and an element may be two bytes long.
fn check_shape(mut bytes: &[u8]) -> Result<(), MessageError> {
    let malformed = |what: &str| MessageError::Malformed(what.to_owned());
    let unreadable = |error: prost::DecodeError| MessageError::Malformed(error.to_string());
    limit(bytes.len(), PEER_MESSAGE_BYTES_MAX, "bytes")?;
    let (_, wire) = decode_key(&mut bytes).map_err(unreadable)?;
    if wire != WireType::LengthDelimited {
        return Err(malformed("unknown kind"));
    }
    let length = decode_varint(&mut bytes).map_err(unreadable)?;
    if length != bytes.len() as u64 {
        return Err(malformed("not exactly one message"));
    }
    let mut fields = 0;
    while !bytes.is_empty() {
        fields += 1;
        limit(fields, FIELDS_MAX, "fields")?;
        let (tag, wire) = decode_key(&mut bytes).map_err(unreadable)?;
        if !matches!(wire, WireType::Varint | WireType::LengthDelimited) {
            return Err(malformed("field of a type that is not used"));
        }
        skip_field(wire, tag, &mut bytes, DecodeContext::default()).map_err(unreadable)?;
    }
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests;
