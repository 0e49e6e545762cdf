//! Messages: what `set` answers and tells.

use serde::{Deserialize, Serialize};

/// Answer of `set`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Published {
    /// The epoch the messages were published under; 0 without a grant.
    pub epoch: u64,
    /// The smallest sequence number that the next `set` may start with.
    pub next_seq: u64,
}

/// Payload of the event `message`, whose subject is the service; the messages are arguments of the transaction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MessageEvent {
    /// The epoch they were published under; 0 without a grant.
    pub epoch: u64,
    /// Sequence number of the first one.
    pub first_seq: u64,
    /// How many they are.
    pub count: u64,
}

/// Payload of the event `permitted`, whose subject is the service: from this block on, these policies permit what a publisher
/// sends without a grant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Permitted {
    /// The publisher, e.g. `Org2/Turtlebot4`.
    pub publisher: String,
    /// Number of the set of policies; 0 for the built-in policy of an owner that has never put one.
    pub policy_version: u64,
    /// Ids of those that permit it, in order; at most [`POLICIES_TOLD_MAX`](crate::POLICIES_TOLD_MAX).
    pub policies: Vec<String>,
}

/// Where the last message of a publisher is: an element of the answer of `latest`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Latest {
    /// The publisher, e.g. `Org2/Turtlebot4`.
    pub publisher: String,
    /// The epoch it was published under; 0 without a grant.
    pub epoch: u64,
    /// Its sequence number.
    pub seq: u64,
    /// How many messages its transaction holds; their sequence numbers end with `seq`.
    pub count: u64,
    /// The block it is in.
    pub height: u64,
}
