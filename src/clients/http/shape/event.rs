//! Events of a chaincode, and what is delivered of them.

use super::{Answer, utc};
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::v1;
use serde::Serialize;

/// An event, as in `ledgerctl block -o json`.
#[derive(Serialize)]
pub(super) struct EventFacts {
    chaincode: String,
    name: String,
    subject: String,
    payload: Answer,
    /// In a stream: the signed call that caused it, with the first of its events.
    #[serde(skip_serializing_if = "Option::is_none")]
    transaction: Option<CallFacts>,
}

impl From<v1::EventRecord> for EventFacts {
    fn from(event: v1::EventRecord) -> Self {
        Self {
            payload: Answer::read(&event.payload),
            transaction: CallFacts::read(event.transaction, event.index),
            chaincode: event.chaincode,
            name: event.name,
            subject: event.subject,
        }
    }
}

/// A signed call.
#[derive(Serialize)]
struct CallFacts {
    id: String,
    index: u32,
    chaincode: String,
    function: String,
    args: Vec<Answer>,
    not_after: u64,
    not_after_utc: Option<String>,
}

impl CallFacts {
    fn read(encoded: Bytes, index: u32) -> Option<Self> {
        let transaction = Transaction::decode(encoded).ok()?;
        let body = transaction.body();
        Some(Self {
            id: transaction.id().to_string(),
            index,
            chaincode: body.chaincode.clone(),
            function: body.function.clone(),
            args: body.args.iter().map(|arg| Answer::read(arg)).collect(),
            not_after: body.not_after,
            not_after_utc: utc(body.not_after),
        })
    }
}

/// The events of a block, or a sign of life without any.
#[derive(Serialize)]
pub(in crate::clients::http) struct DeliveryFacts {
    height: u64,
    time: u64,
    time_utc: Option<String>,
    #[serde(skip_serializing_if = "String::is_empty")]
    block_hash: String,
    events: Vec<EventFacts>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    early: bool,
    #[serde(skip_serializing_if = "String::is_empty")]
    proof: String,
}

impl From<v1::Delivery> for DeliveryFacts {
    fn from(delivery: v1::Delivery) -> Self {
        Self {
            height: delivery.height,
            time: delivery.time,
            time_utc: utc(delivery.time),
            block_hash: hex::encode(delivery.block_hash),
            events: delivery.events.into_iter().map(EventFacts::from).collect(),
            early: delivery.early,
            proof: hex::encode(delivery.proof),
        }
    }
}
