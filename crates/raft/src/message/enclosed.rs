//! Messages that enclose signed bytes which the engine does not look into, but for complaints.

use bytes::Bytes;

/// A statement about a block with the signature of a voter, as `ledger-light` encodes it.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct SignedStatement {
    /// Its bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub signed: Bytes,
}

/// The proof that a node has signed two different things for one place, as `ledger-light` encodes it.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Evidence {
    /// Its bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub proof: Bytes,
}

/// A signed call that was submitted at the sender.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct EarlyCall {
    /// Its bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub transaction: Bytes,
}

/// A complaint of the sender about the leader of a term.
#[derive(Clone, PartialEq, prost::Message)]
pub struct SignedComplaint {
    /// The term.
    #[prost(uint64, tag = "1")]
    pub term: u64,
    /// The leader.
    #[prost(uint64, tag = "2")]
    pub leader: u64,
    /// The signature of the sender below it, as `ledger-light` encodes it.
    #[prost(bytes = "bytes", tag = "3")]
    pub signed: Bytes,
}

/// A control call that was not ordered in time.
#[derive(Clone, PartialEq, prost::Message)]
pub struct UnansweredCall {
    /// The signed bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub transaction: Bytes,
}
