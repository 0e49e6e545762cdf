//! Passing a grant on: for a while, or for good.

use serde::{Deserialize, Serialize};

/// Options of `delegate`, `handover` and `recall`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PassOptions {
    /// When the receiver's grant ends in any case, in milliseconds from now; for `delegate` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_ms: Option<u64>,
    /// May the receiver pass it on, too? For `delegate` only.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub may_delegate: bool,
    /// Does the robot stop between both?
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub stop: bool,
}

/// Payload of the event `delegated`: a grant was passed on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delegated {
    /// The service.
    pub service: String,
    /// The former holder.
    pub giver: String,
    /// The holder now.
    pub receiver: String,
    /// The epoch of its grant.
    pub epoch: u64,
    /// Can the giver not take it back?
    pub for_good: bool,
    /// When it ends in any case (block time, microseconds), if the giver said so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ends_by: Option<u64>,
}
