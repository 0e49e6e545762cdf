//! Events as they are delivered.

use ledger_api::facts::{EventFacts, utc};
use ledger_api::v1;
use ledger_base::hash::Hash;
use serde::Serialize;

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

impl DeliveryFacts {
    /// The facts of a delivery; `name_of` names the owner of a certificate by its SHA-256.
    pub(in crate::clients::http) fn of(delivery: v1::Delivery, mut name_of: impl FnMut(&Hash) -> String) -> Self {
        let mut events: Vec<_> = delivery.events.into_iter().map(EventFacts::from).collect();
        for call in events.iter_mut().filter_map(|event| event.transaction.as_mut()) {
            call.creator = name_of(&call.certificate);
        }
        Self {
            height: delivery.height,
            time: delivery.time,
            time_utc: utc(delivery.time),
            block_hash: hex::encode(delivery.block_hash),
            events,
            early: delivery.early,
            proof: hex::encode(delivery.proof),
        }
    }
}
