//! What executing a block gave: verdicts, responses and events. Kept beside the chain; executing it again gives the
//! same.

use crate::Hash;
use crate::block::Header;
use crate::chaincode::Event;
use crate::code::Code;
use crate::rejection::Rejection;
use bytes::Bytes;
use prost::Message;

/// What became of one transaction.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct TransactionResult {
    /// Number of the [`Code`].
    #[prost(uint32, tag = "1")]
    pub code: u32,
    /// What the function returned.
    #[prost(bytes = "bytes", tag = "2")]
    pub response: Bytes,
    /// First line of a refusal.
    #[prost(string, tag = "3")]
    pub message: String,
    /// See [`Rejection::found`].
    #[prost(string, tag = "4")]
    pub found: String,
    /// See [`Rejection::wanted`].
    #[prost(string, tag = "5")]
    pub wanted: String,
    /// See [`Rejection::next`].
    #[prost(string, tag = "6")]
    pub next: String,
}

impl TransactionResult {
    /// The stable code; a number that this version does not know reads as [`Code::Internal`].
    pub fn code(&self) -> Code {
        u16::try_from(self.code).ok().and_then(Code::from_number).unwrap_or(Code::Internal)
    }

    /// The response or the refusal.
    ///
    /// # Errors
    /// The refusal.
    pub fn outcome(&self) -> Result<Bytes, Rejection> {
        match self.code() {
            Code::Ok => Ok(self.response.clone()),
            code => Err(Rejection {
                code,
                message: self.message.clone(),
                found: self.found.clone(),
                wanted: self.wanted.clone(),
                next: self.next.clone(),
            }),
        }
    }
}

impl From<Result<Bytes, Rejection>> for TransactionResult {
    fn from(outcome: Result<Bytes, Rejection>) -> Self {
        match outcome {
            Ok(response) => Self { response, ..Self::default() },
            Err(Rejection { code, message, found, wanted, next }) => {
                Self { code: code.number().into(), response: Bytes::new(), message, found, wanted, next }
            }
        }
    }
}

/// An event and what caused it.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct EmittedEvent {
    /// Position of the transaction in the block; none if the block itself caused it.
    #[prost(uint32, optional, tag = "1")]
    pub index: Option<u32>,
    /// The event.
    #[prost(message, required, tag = "2")]
    pub event: Event,
}

/// What kind of entry a block is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, prost::Enumeration)]
#[repr(i32)]
pub enum BlockKind {
    /// Transactions, perhaps none.
    Transactions = 0,
    /// A change of the nodes that order.
    Membership = 1,
    /// The first block.
    Genesis = 2,
}

/// What executing a block gave.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct BlockResult {
    /// Its term.
    #[prost(uint64, tag = "1")]
    pub term: u64,
    /// Block time, microseconds since the UNIX epoch.
    #[prost(uint64, tag = "2")]
    pub time: u64,
    /// Hash of the previous header.
    #[prost(bytes = "bytes", tag = "3")]
    pub previous: Bytes,
    /// Root over its content.
    #[prost(bytes = "bytes", tag = "4")]
    pub root: Bytes,
    /// State digest after it.
    #[prost(bytes = "bytes", tag = "5")]
    pub digest: Bytes,
    /// What it is.
    #[prost(enumeration = "BlockKind", tag = "6")]
    pub kind: i32,
    /// One for each transaction.
    #[prost(message, repeated, tag = "7")]
    pub results: Vec<TransactionResult>,
    /// In the order in which they were emitted.
    #[prost(message, repeated, tag = "8")]
    pub events: Vec<EmittedEvent>,
}

impl BlockResult {
    /// The header of the block at this height.
    pub fn header(&self, height: u64) -> Header {
        let hash = |bytes: &[u8]| Hash::from_slice(bytes).unwrap_or(Hash::ZERO);
        Header { height, term: self.term, time: self.time, previous: hash(&self.previous), root: hash(&self.root) }
    }

    /// State digest after the block.
    pub fn digest(&self) -> Hash {
        Hash::from_slice(&self.digest).unwrap_or(Hash::ZERO)
    }

    pub(crate) fn to_bytes(&self) -> Bytes {
        self.encode_to_vec().into()
    }

    pub(crate) fn from_bytes(bytes: Bytes) -> Result<Self, Rejection> {
        Self::decode(bytes)
            .map_err(|error| Rejection::new(Code::Corrupt, format!("a stored block result cannot be read: {error}")))
    }
}
