//! Blocks and transactions.

use super::event::EventFacts;
use super::{Answer, code_text, utc};
use ledger::transaction::Transaction;
use ledger_api::v1;
use serde::Serialize;

/// A block, as `ledgerctl block -o json` prints it.
#[derive(Serialize)]
pub(in crate::clients::http) struct BlockFacts {
    height: u64,
    term: u64,
    time: u64,
    time_utc: Option<String>,
    kind: String,
    hash: String,
    previous_hash: String,
    root: String,
    state_digest: String,
    transactions: Vec<TransactionFacts>,
    /// Those that the block itself caused.
    events: Vec<EventFacts>,
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

/// A transaction with its place and its verdict, as `ledgerctl tx -o json` prints it.
#[derive(Serialize)]
pub(in crate::clients::http) struct TransactionFacts {
    id: String,
    height: u64,
    index: u32,
    time: u64,
    time_utc: Option<String>,
    creator: String,
    /// Empty where the caller may not read the call.
    chaincode: String,
    function: String,
    args: Vec<Answer>,
    not_after: u64,
    not_after_utc: Option<String>,
    code: String,
    message: String,
    events: Vec<EventFacts>,
    #[serde(flatten)]
    response: Answer,
}

impl From<v1::TransactionRecord> for TransactionFacts {
    fn from(record: v1::TransactionRecord) -> Self {
        let body = Transaction::decode(record.transaction).map(|transaction| transaction.body().clone());
        let (body, verdict) = (body.unwrap_or_default(), record.verdict.unwrap_or_default());
        Self {
            id: hex::encode(record.id),
            height: record.height,
            index: record.index,
            time: record.time,
            time_utc: utc(record.time),
            creator: record.creator,
            chaincode: body.chaincode,
            function: body.function,
            args: body.args.iter().map(|arg| Answer::read(arg)).collect(),
            not_after: body.not_after,
            not_after_utc: utc(body.not_after),
            code: code_text(verdict.code),
            message: verdict.message,
            events: record.events.into_iter().map(EventFacts::from).collect(),
            response: Answer::read(&record.response),
        }
    }
}
