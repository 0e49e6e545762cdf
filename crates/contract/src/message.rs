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
