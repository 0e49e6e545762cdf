//! The facts that executing a block gives: the leaves under its results root.
//!
//! The ground comes first. Then follow the verdicts in the order of transactions, the events in the order in which they were
//! emitted, and the writes of control state in the order of keys.

use crate::codec::{Reader, put};
use crate::merkle;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;

/// In front of the content of each leaf.
const DOMAIN: &[u8] = b"ledgerd fact v1\0";
/// Longest text or key in a fact.
pub const PART_BYTES_MAX: usize = 4096;
/// Longest encoding of a fact.
pub const FACT_BYTES_MAX: usize = DOMAIN.len() + 64 + 3 * (4 + PART_BYTES_MAX);

const GROUND: u8 = 1;
const VERDICT: u8 = 2;
const EVENT: u8 = 3;
const CONTROL: u8 = 4;

/// A fact. Values stand as their hashes: who is told a value compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fact<'a> {
    /// The ground that the block stands on; the first leaf of each block.
    Ground {
        /// The governing chain after the block.
        governing: Hash,
        /// The control chain after the block.
        control: Hash,
        /// The state digest after the block.
        digest: Hash,
        /// The results root of the block before; zero where there is none.
        previous: Hash,
    },
    /// The verdict on a transaction.
    Verdict {
        /// Its position in the block.
        index: u32,
        /// Its id; zero where the bytes are no transaction.
        id: Hash,
        /// Number of the code.
        code: u32,
        /// Hash of the answer, which is empty if it was refused.
        response: Hash,
    },
    /// An event.
    Event {
        /// Position of the transaction that caused it; none if the block itself did.
        index: Option<u32>,
        /// The chaincode that emitted it.
        chaincode: &'a str,
        /// Its name.
        name: &'a str,
        /// Its subject.
        subject: &'a str,
        /// Hash of its payload.
        payload: Hash,
    },
    /// A write of control state.
    Control {
        /// The key, with its chaincode.
        key: &'a [u8],
        /// Hash of the value; none if the key was deleted.
        value: Option<Hash>,
    },
}

impl<'a> Fact<'a> {
    /// Its leaf in the tree.
    pub fn leaf(&self) -> Hash {
        Hash::of(&[&[0x00], &self.to_bytes()])
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(192);
        bytes.extend_from_slice(DOMAIN);
        match self {
            Self::Ground { governing, control, digest, previous } => {
                bytes.push(GROUND);
                [governing, control, digest, previous].iter().for_each(|hash| bytes.extend_from_slice(&hash.0));
            }
            Self::Verdict { index, id, code, response } => {
                bytes.push(VERDICT);
                bytes.extend_from_slice(&index.to_be_bytes());
                bytes.extend_from_slice(&id.0);
                bytes.extend_from_slice(&code.to_be_bytes());
                bytes.extend_from_slice(&response.0);
            }
            Self::Event { index, chaincode, name, subject, payload } => {
                bytes.push(EVENT);
                put_optional(&mut bytes, index.map(u32::to_be_bytes).as_ref().map(<[u8; 4]>::as_slice));
                [chaincode, name, subject].iter().for_each(|text| put(&mut bytes, text.as_bytes()));
                bytes.extend_from_slice(&payload.0);
            }
            Self::Control { key, value } => {
                bytes.push(CONTROL);
                put(&mut bytes, key);
                put_optional(&mut bytes, value.as_ref().map(Hash::as_ref));
            }
        }
        bytes
    }

    /// Reads its bytes.
    ///
    /// # Errors
    /// [`Code::TooLarge`](ledger_base::rejection::Code::TooLarge), [`Code::Malformed`](ledger_base::rejection::Code::Malformed).
    pub fn from_bytes(bytes: &'a [u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a fact of a block", FACT_BYTES_MAX, DOMAIN, bytes)?;
        let fact = match reader.byte()? {
            GROUND => Self::Ground {
                governing: reader.hash()?,
                control: reader.hash()?,
                digest: reader.hash()?,
                previous: reader.hash()?,
            },
            VERDICT => Self::Verdict {
                index: reader.u32()?,
                id: reader.hash()?,
                code: reader.u32()?,
                response: reader.hash()?,
            },
            EVENT => Self::Event {
                index: if present(&mut reader)? { Some(reader.u32()?) } else { None },
                chaincode: reader.text(PART_BYTES_MAX)?,
                name: reader.text(PART_BYTES_MAX)?,
                subject: reader.text(PART_BYTES_MAX)?,
                payload: reader.hash()?,
            },
            CONTROL => Self::Control {
                key: reader.part(PART_BYTES_MAX)?,
                value: if present(&mut reader)? { Some(reader.hash()?) } else { None },
            },
            _ => return Err(reader.malformed("an unknown kind", "1 to 4")),
        };
        reader.end()?;
        Ok(fact)
    }
}

/// The results root over facts in their order.
pub fn root<'a>(facts: impl IntoIterator<Item = Fact<'a>>) -> Hash {
    merkle::root(facts.into_iter().map(|fact| fact.leaf()).collect())
}

fn put_optional(bytes: &mut Vec<u8>, part: Option<&[u8]>) {
    bytes.push(u8::from(part.is_some()));
    bytes.extend_from_slice(part.unwrap_or_default());
}

fn present(reader: &mut Reader<'_>) -> Result<bool, Rejection> {
    match reader.byte()? {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(reader.malformed("another mark", "0 for nothing, 1 for something")),
    }
}
