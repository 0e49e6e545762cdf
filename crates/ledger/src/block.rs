//! Blocks: what a committed log entry means to the ledger.
//!
//! A block is a committed entry of the ordering log and its height is the entry's index. The leader decides
//! the [`Payload`]; the [`Header`] is computed by every node alike when it applies the entry.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::{BranchLink, block_hash, merkle};
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::results::INDEXED_TRANSACTIONS_MAX;
use prost::Message;

/// Most transactions in one block. Bounds the work of one step of the executor.
pub const TRANSACTIONS_MAX: usize = 4096;
const _: () = assert!(TRANSACTIONS_MAX <= INDEXED_TRANSACTIONS_MAX, "every transaction of a block can be found");
/// Most bytes of transactions in one block, so that a block fits one record, one message and one write.
pub const PAYLOAD_BYTES_MAX: usize = 8 * 1024 * 1024;

/// The data of an ordinary log entry: what the leader put into the block.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Payload {
    /// The leader's clock when it made the block, microseconds since the UNIX epoch. Block time is the
    /// largest of these so far, so it never goes back.
    #[prost(uint64, tag = "1")]
    pub time: u64,
    /// The transactions exactly as they were signed.
    #[prost(bytes = "bytes", repeated, tag = "2")]
    pub transactions: Vec<Bytes>,
}

impl Payload {
    /// The bytes of a log entry.
    pub fn to_bytes(&self) -> Bytes {
        self.encode_to_vec().into()
    }

    /// Reads the data of an entry. The empty entry that a new leader appends is an empty block.
    ///
    /// # Errors
    /// [`Code::Malformed`] if the bytes are no payload, [`Code::TooLarge`] beyond the limits.
    pub fn from_bytes(data: Bytes) -> Result<Self, Rejection> {
        if data.len() > PAYLOAD_BYTES_MAX + TRANSACTIONS_MAX * 8 {
            return Err(Rejection::new(Code::TooLarge, "the block payload is too large")
                .found(format!("{} bytes", data.len()))
                .wanted(format!("at most {PAYLOAD_BYTES_MAX} bytes")));
        }
        let payload = Self::decode(data)
            .map_err(|error| Rejection::new(Code::Malformed, format!("the block payload cannot be read: {error}")))?;
        if payload.transactions.len() > TRANSACTIONS_MAX {
            return Err(Rejection::new(Code::TooLarge, "the block has too many transactions")
                .found(payload.transactions.len().to_string())
                .wanted(format!("at most {TRANSACTIONS_MAX}")));
        }
        Ok(payload)
    }
}

/// The link of the chain: computed identically by every node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Index of the log entry; the genesis block has height 0.
    pub height: u64,
    /// Raft term in which the entry was proposed.
    pub term: u64,
    /// Block time, microseconds since the UNIX epoch; never decreases.
    pub time: u64,
    /// Hash of the previous header.
    pub previous: Hash,
    /// Merkle root over the content (RFC 6962 §2.1 over the signed transactions).
    pub root: Hash,
}

impl Header {
    /// The link that an entry adds to a chain, as executing it computes it: from the block before, its hash and its time.
    pub fn following(previous: Hash, time: u64, entry: &Entry) -> Self {
        let (root, payload) = content(entry);
        let time = payload.map_or(0, |payload| payload.time).max(time);
        Self { height: entry.index, term: entry.term, time, previous, root }
    }

    /// SHA-256 over the domain tag and the fields in order, integers big-endian.
    pub fn hash(&self) -> Hash {
        let Self { height, term, time, previous, root } = *self;
        block_hash(height, &BranchLink { term, time, root }, previous)
    }
}

/// The root over the content of an entry, and its payload if it is one.
pub fn content(entry: &Entry) -> (Hash, Option<Payload>) {
    // A leader that orders rubbish gets an empty block, on every node alike.
    let payload = match entry.kind {
        EntryKind::Normal => Payload::from_bytes(entry.data.clone()).ok(),
        EntryKind::ConfChange | EntryKind::ConfChangeV2 => None,
    };
    let root = payload.as_ref().map_or_else(
        || opaque_root(entry),
        |payload| merkle::root(payload.transactions.iter().map(|transaction| leaf(transaction)).collect()),
    );
    (root, payload)
}

/// The leaf of a transaction in the Merkle tree; also the key under which a node remembers that it has
/// already verified exactly these bytes.
pub fn leaf(transaction: &[u8]) -> Hash {
    Hash::of(&[&[0x00], transaction])
}

/// The root of an entry that is no list of transactions. It covers the kind: a change of members and rubbish with the
/// same bytes are two blocks.
pub fn opaque_root(entry: &Entry) -> Hash {
    Hash::of(&[&[0x02, entry.kind.code()], &entry.data])
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn an_empty_entry_is_an_empty_block() {
        assert_eq!(Payload::from_bytes(Bytes::new()).unwrap(), Payload::default());
    }

    #[test]
    fn a_payload_of_too_many_transactions_is_refused() {
        let payload = Payload { time: 1, transactions: vec![Bytes::new(); TRANSACTIONS_MAX + 1] };
        assert_eq!(Payload::from_bytes(payload.to_bytes()).unwrap_err().code, Code::TooLarge);
    }

    #[test]
    fn a_change_of_members_and_rubbish_with_the_same_bytes_have_different_hashes() {
        let entry = |kind| Entry { index: 1, term: 1, kind, data: Bytes::from_static(b"\xff") };
        let hash = |kind| Header::following(Hash::ZERO, 0, &entry(kind)).hash();
        assert_ne!(hash(EntryKind::Normal), hash(EntryKind::ConfChangeV2));
    }

    #[test]
    fn a_truncated_payload_is_refused_at_every_cut_that_is_no_shorter_payload() {
        let payload = Payload { time: 7, transactions: vec![Bytes::from_static(b"abc"), Bytes::from_static(b"def")] };
        let bytes = payload.to_bytes();
        for cut in 0..bytes.len() {
            if let Ok(read) = Payload::from_bytes(bytes.slice(..cut)) {
                assert_ne!(read, payload);
            }
        }
    }
}
