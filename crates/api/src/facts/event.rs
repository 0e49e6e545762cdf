//! Events of a chaincode, and the signed calls that caused them.

use super::{DecodedBytes, utc};
use crate::v1;
use bytes::Bytes;
use ledger::transaction::{Body, Transaction};
use ledger_base::hash::Hash;
use serde::Serialize;

/// An event.
#[derive(Debug, Serialize)]
pub struct EventFacts {
    /// The chaincode that emitted it.
    pub chaincode: String,
    /// Its name, such as `granted`.
    pub name: String,
    /// Its subject, such as a service.
    pub subject: String,
    /// Its payload.
    pub payload: DecodedBytes,
    /// In a stream: the signed call that caused it, with the first of its events.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transaction: Option<SignedCallFacts>,
}

impl From<v1::EventRecord> for EventFacts {
    fn from(event: v1::EventRecord) -> Self {
        Self {
            payload: DecodedBytes::read(&event.payload),
            transaction: SignedCallFacts::read(event.transaction, event.index),
            chaincode: event.chaincode,
            name: event.name,
            subject: event.subject,
        }
    }
}

/// A signed call and its position in the block.
#[derive(Debug, Serialize)]
pub struct SignedCallFacts {
    /// Id of the transaction.
    pub id: String,
    /// Position in the block.
    pub index: u32,
    /// The signer, such as `Org1/Salma`, where the node names it.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub creator: String,
    /// SHA-256 of the signer's certificate.
    #[serde(skip)]
    pub certificate: Hash,
    /// The call.
    #[serde(flatten)]
    pub call: CallFacts,
}

impl SignedCallFacts {
    fn read(encoded: Bytes, index: u32) -> Option<Self> {
        let transaction = Transaction::decode(encoded).ok()?;
        Some(Self {
            id: transaction.id().to_string(),
            index,
            creator: String::new(),
            certificate: transaction.creator(),
            call: transaction.body().into(),
        })
    }
}

/// A call of a chaincode.
#[derive(Debug, Serialize)]
pub struct CallFacts {
    /// The chaincode; empty where the caller may not read the call.
    pub chaincode: String,
    /// The function.
    pub function: String,
    /// Its arguments.
    pub args: Vec<DecodedBytes>,
    /// The last moment at which it is executed.
    pub not_after: u64,
    not_after_utc: Option<String>,
}

impl From<&Body> for CallFacts {
    fn from(body: &Body) -> Self {
        Self {
            chaincode: body.chaincode.clone(),
            function: body.function.clone(),
            args: body.args.iter().map(|arg| DecodedBytes::read(arg)).collect(),
            not_after: body.not_after,
            not_after_utc: utc(body.not_after),
        }
    }
}
