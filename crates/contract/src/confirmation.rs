//! Confirmation: a contender that others must confirm before it competes for a service.

use crate::line::Acquired;
use serde::{Deserialize, Serialize};

/// A contender that waits to be confirmed; also the payload of the events `pending` and `confirmed`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pending {
    /// The service.
    pub service: String,
    /// The contender, e.g. `Org1/Salma`.
    pub contender: String,
    /// Those who have confirmed it.
    pub confirmed: Vec<String>,
    /// How many must.
    pub wanted: u64,
    /// The organisation whose policies say who may: its admins, and whom they permit `confirm`.
    pub owner: String,
    /// Until when confirmations are waited for, and count (block time, microseconds).
    pub until: u64,
}

/// Answer of `confirm`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confirmation {
    /// The contender, with this confirmation.
    pub pending: Pending,
    /// The contender's grant, or its place in line, if this was the last confirmation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acquired: Option<Acquired>,
    /// Why it cannot have the service though it is confirmed; it may acquire it until the confirmations end.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub refused: String,
}
