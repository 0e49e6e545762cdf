//! Events as they are delivered.

use ledger_api::facts::{EventFacts, utc};
use ledger_api::v1;
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
