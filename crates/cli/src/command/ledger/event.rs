//! The events of a block or a transaction.

use crate::answer::Answer;
use ledger_api::v1;
use serde::Serialize;

/// An event of a chaincode.
#[derive(Serialize)]
pub(super) struct EventFacts {
    chaincode: String,
    name: String,
    pub(super) subject: String,
    payload: Answer,
}

impl From<v1::EventRecord> for EventFacts {
    fn from(event: v1::EventRecord) -> Self {
        Self {
            chaincode: event.chaincode,
            name: event.name,
            subject: event.subject,
            payload: Answer::read(&event.payload),
        }
    }
}

impl EventFacts {
    /// `abac granted`
    pub(super) fn what(&self) -> String {
        format!("{} {}", self.chaincode, self.name)
    }

    /// The payload in one line.
    pub(super) fn details(&self) -> String {
        self.payload.to_text().replace('\n', " ")
    }
}
