//! The result of executing a block: verdicts, responses and events. Kept beside the chain; executing it again gives the
//! same.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use prost::Message;

/// The outcome of one transaction.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct TransactionResult {
    /// Number of the [`Code`].
    #[prost(uint32, tag = "1")]
    pub code: u32,
    /// The answer of the function.
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
    /// See [`Rejection::own_advice`]: the general advice of the code is not stored.
    #[prost(string, tag = "6")]
    pub next: String,
    /// Id of the transaction, 32 bytes; empty where the bytes are no transaction.
    #[prost(bytes = "bytes", tag = "7")]
    pub id: Bytes,
    /// Until when the id is remembered, in block time. None if this is not the verdict on the id: it was executed
    /// before, or nobody who is known has signed it.
    #[prost(uint64, optional, tag = "8")]
    pub not_after: Option<u64>,
}

impl TransactionResult {
    /// Id of the transaction; zero where the bytes are no transaction.
    pub fn id(&self) -> Hash {
        Hash::from_slice(&self.id).unwrap_or(Hash::ZERO)
    }

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
            code => Err(Rejection::new(code, self.message.clone())
                .found(self.found.clone())
                .wanted(self.wanted.clone())
                .next(self.next.clone())),
        }
    }
}

impl From<Result<Bytes, Rejection>> for TransactionResult {
    fn from(outcome: Result<Bytes, Rejection>) -> Self {
        match outcome {
            Ok(response) => Self { response, ..Self::default() },
            Err(rejection) => {
                let next = rejection.own_advice().to_owned();
                let Rejection { code, message, found, wanted, .. } = rejection;
                Self { code: code.number().into(), message, found, wanted, next, ..Self::default() }
            }
        }
    }
}

/// Something that a chaincode tells the world, delivered to subscribers in block order together with the
/// transaction that caused it.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct Event {
    /// The chaincode that emitted it.
    #[prost(string, tag = "1")]
    pub chaincode: String,
    /// The event, e.g. `message` or `granted`.
    #[prost(string, tag = "2")]
    pub name: String,
    /// The subject of the event, e.g. the service `Turtlebot4/cmd_vel`. Subscribers filter by it.
    #[prost(string, tag = "3")]
    pub subject: String,
    /// Details, usually JSON. Parts of the transaction are not repeated here.
    #[prost(bytes = "bytes", tag = "4")]
    pub payload: Bytes,
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

/// The kind of entry of a block.
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

/// The hashes over what executing a block gave, as its voters sign it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Roots {
    /// The governing chain after the block.
    pub governing: Hash,
    /// The control chain after the block.
    pub control: Hash,
    /// The results root of the block.
    pub results: Hash,
}

impl Roots {
    /// One after the other.
    pub fn to_bytes(&self) -> Bytes {
        [self.governing.0, self.control.0, self.results.0].concat().into()
    }

    /// Reads them; none of bytes that are something else.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (governing, rest) = bytes.split_at_checked(size_of::<Hash>())?;
        let (control, results) = rest.split_at_checked(size_of::<Hash>())?;
        let hash = Hash::from_slice;
        Some(Self { governing: hash(governing)?, control: hash(control)?, results: hash(results)? })
    }
}

/// The result of executing a block.
#[derive(Clone, PartialEq, Eq, prost::Message)]
pub struct BlockResult {
    /// Its term.
    #[prost(uint64, tag = "1")]
    pub term: u64,
    /// Block time, microseconds since the UNIX epoch.
    #[prost(uint64, tag = "2")]
    pub time: u64,
    /// Hash of its header, 32 bytes. The header itself follows from the block and the hash of the one before.
    #[prost(bytes = "bytes", tag = "3")]
    pub hash: Bytes,
    /// State digest after it, 32 bytes.
    #[prost(bytes = "bytes", tag = "4")]
    pub digest: Bytes,
    /// The kind.
    #[prost(enumeration = "BlockKind", tag = "5")]
    pub kind: i32,
    /// One for each transaction.
    #[prost(message, repeated, tag = "6")]
    pub results: Vec<TransactionResult>,
    /// In the order in which they were emitted.
    #[prost(message, repeated, tag = "7")]
    pub events: Vec<EmittedEvent>,
    /// Its [`Roots`], 96 bytes; empty if the block is not certified.
    #[prost(bytes = "bytes", tag = "10")]
    pub roots: Bytes,
    /// Hash over what it wrote, 32 bytes: with the verdicts it gives the step from one state digest to the next.
    #[prost(bytes = "bytes", tag = "11")]
    pub writes: Bytes,
}

impl BlockResult {
    /// Governing chain, control chain and results root.
    pub fn roots(&self) -> Option<Roots> {
        Roots::from_bytes(&self.roots)
    }

    /// Hash of the block's header.
    pub fn hash(&self) -> Hash {
        Hash::from_slice(&self.hash).unwrap_or(Hash::ZERO)
    }

    /// State digest after the block.
    pub fn digest(&self) -> Hash {
        Hash::from_slice(&self.digest).unwrap_or(Hash::ZERO)
    }

    /// Hash over what the block wrote.
    pub fn writes(&self) -> Hash {
        Hash::from_slice(&self.writes).unwrap_or(Hash::ZERO)
    }

    /// The transactions whose ids this block has taken: position, id, and until when it is remembered.
    pub fn taken(&self) -> impl Iterator<Item = (u32, Hash, u64)> + '_ {
        (0u32..).zip(&self.results).filter_map(|(position, result)| Some((position, result.id(), result.not_after?)))
    }

    /// Only what blocks determine: without the words of refusals and without events, which may differ between versions
    /// of the program.
    pub fn determined(mut self) -> Self {
        self.events.clear();
        for result in &mut self.results {
            for text in [&mut result.message, &mut result.found, &mut result.wanted, &mut result.next] {
                text.clear();
            }
        }
        self
    }

    /// The bytes that are stored.
    pub fn to_bytes(&self) -> Bytes {
        self.encode_to_vec().into()
    }

    /// Reads what was stored.
    ///
    /// # Errors
    /// [`Code::Corrupt`].
    pub fn from_bytes(bytes: Bytes) -> Result<Self, Rejection> {
        Self::decode(bytes)
            .map_err(|error| Rejection::new(Code::Corrupt, format!("a stored block result cannot be read: {error}")))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_stored_verdict_leaves_out_the_general_advice_of_its_code_and_shows_it_again() {
        let behind = Rejection::new(Code::Behind, "m").found("f").wanted("w");
        let stored = TransactionResult::from(Err(behind.clone()));
        assert_eq!((stored.found.as_str(), stored.next.as_str()), ("f", ""));
        let read = stored.outcome().unwrap_err();
        assert_eq!((read.advice(), &read), (Code::Behind.advice(), &behind));
        let own = TransactionResult::from(Err(behind.next("wait")));
        assert_eq!((own.next.as_str(), own.outcome().unwrap_err().advice()), ("wait", "wait"));
    }
}
