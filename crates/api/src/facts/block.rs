//! Blocks and transactions.

use super::event::{CallFacts, EventFacts};
use super::{DecodedBytes, code_text, utc};
use crate::v1;
use ledger::transaction::{Body, Transaction};
use serde::Serialize;

/// A block.
#[derive(Debug, Serialize)]
pub struct BlockFacts {
    /// Index in the ordering log; 0 is the genesis.
    pub height: u64,
    /// Term of the leader that ordered it.
    pub term: u64,
    /// Block time.
    pub time: u64,
    time_utc: Option<String>,
    /// `transactions`, `membership` or `genesis`.
    pub kind: String,
    /// Hash of its header.
    pub hash: String,
    /// Hash of the block before.
    pub previous_hash: String,
    /// Root of the Merkle tree over its transactions.
    pub root: String,
    /// Digest of the world state after it.
    pub state_digest: String,
    /// Its transactions, in order.
    pub transactions: Vec<TransactionFacts>,
    /// Events that the block itself caused, such as the end of a grant.
    pub events: Vec<EventFacts>,
}

impl From<v1::Block> for BlockFacts {
    fn from(block: v1::Block) -> Self {
        Self {
            height: block.height,
            term: block.term,
            time: block.time,
            time_utc: utc(block.time),
            kind: block.kind,
            hash: hex::encode(block.hash),
            previous_hash: hex::encode(block.previous_hash),
            root: hex::encode(block.root),
            state_digest: hex::encode(block.state_digest),
            transactions: block.transactions.into_iter().map(TransactionFacts::from).collect(),
            events: block.events.into_iter().map(EventFacts::from).collect(),
        }
    }
}

/// A transaction with its position and its verdict.
#[derive(Debug, Serialize)]
pub struct TransactionFacts {
    /// Hash of its body.
    pub id: String,
    /// Height of its block.
    pub height: u64,
    /// Position in the block.
    pub index: u32,
    /// Block time.
    pub time: u64,
    time_utc: Option<String>,
    /// The signer, such as `Org1/Salma`.
    pub creator: String,
    /// The call.
    #[serde(flatten)]
    pub call: CallFacts,
    /// The verdict: `OK`, or a code.
    pub code: String,
    /// Why it was rejected.
    pub message: String,
    /// Events that it caused, as far as the caller may read them.
    pub events: Vec<EventFacts>,
    /// Enough voters have signed its block or a later one.
    pub certified: bool,
    /// The return value of the function.
    #[serde(flatten)]
    pub response: DecodedBytes,
}

impl From<v1::TransactionRecord> for TransactionFacts {
    fn from(record: v1::TransactionRecord) -> Self {
        let transaction = Transaction::decode(record.transaction).ok();
        let verdict = record.verdict.unwrap_or_default();
        Self {
            id: hex::encode(record.id),
            height: record.height,
            index: record.index,
            time: record.time,
            time_utc: utc(record.time),
            creator: record.creator,
            // A transaction that the caller may not read, or that this version cannot, still has its position and its verdict.
            call: transaction.as_ref().map_or(&Body::default(), Transaction::body).into(),
            code: code_text(verdict.code),
            message: verdict.message,
            events: record.events.into_iter().map(EventFacts::from).collect(),
            certified: record.certified,
            response: DecodedBytes::read(&record.response),
        }
    }
}
