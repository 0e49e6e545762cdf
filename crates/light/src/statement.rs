//! A statement about a block, and the signature of a voter below it.

use crate::codec::{Reader, put};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::CERTIFICATE_BYTES_MAX;
use ledger_identity::key::SigningKey;

/// In front of the bytes that are signed.
const DOMAIN: &[u8] = b"ledgerd statement v1\0";
/// Bytes of a statement, without the number of the node that signs it.
pub const STATEMENT_BYTES: usize = DOMAIN.len() + 3 * 8 + 3 * 32;
/// Longest signature: ECDSA P-256 in DER.
pub const SIGNATURE_BYTES_MAX: usize = 72;
/// Longest encoding of a signed statement.
pub const SIGNED_BYTES_MAX: usize = STATEMENT_BYTES + ENCLOSED_BYTES_MAX;
/// Longest encoding of a signature with its certificate.
pub const ENCLOSED_BYTES_MAX: usize = 8 + 4 + CERTIFICATE_BYTES_MAX + 4 + SIGNATURE_BYTES_MAX;

/// The outcome of a block, as a voter states it. Its place is network, number of forced recoveries, height and the node that
/// signs it. An honest node signs one block for each place, ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Statement {
    /// Name of the network.
    pub network: Hash,
    /// Number of forced recoveries before the block.
    pub recoveries: u64,
    /// Height of the block.
    pub height: u64,
    /// Block time, microseconds since the UNIX epoch. The block's hash covers it. Here it stands for all who do not have
    /// the header: it says how fresh the statement is, and at which time the signers' certificates must be valid.
    pub time: u64,
    /// Hash of the block.
    pub block: Hash,
    /// Root over the facts that executing it gave.
    pub results: Hash,
}

/// The signature of a voter, with what it takes to check it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signature {
    /// Number of the node in the ordering.
    pub node: u64,
    /// The node's certificate, DER: keys are renewed, and who checks need not have seen each of them.
    pub certificate: Bytes,
    /// The signature of [`Statement::signed_by`], or of [`Vote::to_bytes`](crate::Vote::to_bytes), by the certificate's key.
    pub signature: Bytes,
}

/// A statement with the signature of one node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signed {
    /// The statement.
    pub statement: Statement,
    /// Its signature.
    pub signature: Signature,
}

impl Statement {
    /// Its bytes, without the node that signs it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(STATEMENT_BYTES + 8);
        bytes.extend_from_slice(DOMAIN);
        bytes.extend_from_slice(&self.network.0);
        bytes.extend_from_slice(&self.recoveries.to_be_bytes());
        bytes.extend_from_slice(&self.height.to_be_bytes());
        bytes.extend_from_slice(&self.time.to_be_bytes());
        bytes.extend_from_slice(&self.block.0);
        bytes.extend_from_slice(&self.results.0);
        bytes
    }

    /// The bytes that this node signs: the statement and the number of the node.
    pub fn signed_by(&self, node: u64) -> Vec<u8> {
        let mut bytes = self.to_bytes();
        bytes.extend_from_slice(&node.to_be_bytes());
        bytes
    }

    /// Do both name the same place, if one node has signed them?
    pub fn is_at_place_of(&self, other: &Self) -> bool {
        (self.network, self.recoveries, self.height) == (other.network, other.recoveries, other.height)
    }

    /// Reads its bytes.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a statement", STATEMENT_BYTES, b"", bytes)?;
        let statement = Self::read(&mut reader)?;
        reader.end()?;
        Ok(statement)
    }

    pub(crate) fn read(reader: &mut Reader<'_>) -> Result<Self, Rejection> {
        if reader.take(DOMAIN.len())? != DOMAIN {
            return Err(reader.malformed("other first bytes", "those of a statement of version 1"));
        }
        let (network, recoveries, height, time) = (reader.hash()?, reader.u64()?, reader.u64()?, reader.u64()?);
        Ok(Self { network, recoveries, height, time, block: reader.hash()?, results: reader.hash()? })
    }

    /// Signs it as a node with this certificate.
    ///
    /// # Errors
    /// [`Code::Internal`] if the system's randomness fails.
    pub fn sign(&self, node: u64, certificate: Bytes, key: &SigningKey) -> Result<Signed, Rejection> {
        let signature = Signature::make(node, certificate, key, &self.signed_by(node))?;
        Ok(Signed { statement: *self, signature })
    }
}

impl Signature {
    /// The signature of these bytes.
    pub(crate) fn make(node: u64, certificate: Bytes, key: &SigningKey, signed: &[u8]) -> Result<Self, Rejection> {
        let signature = key.sign(signed);
        if signature.is_empty() {
            return Err(Rejection::new(Code::Internal, "the system's source of randomness failed"));
        }
        Ok(Self { node, certificate, signature: signature.into() })
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = Vec::new();
        self.write(&mut bytes);
        bytes.into()
    }

    /// Reads its bytes. It is not checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a signature", ENCLOSED_BYTES_MAX, b"", bytes)?;
        let signature = Self::read(&mut reader)?;
        reader.end()?;
        Ok(signature)
    }

    pub(crate) fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.node.to_be_bytes());
        put(bytes, &self.certificate);
        put(bytes, &self.signature);
    }

    pub(crate) fn read(reader: &mut Reader<'_>) -> Result<Self, Rejection> {
        let (node, certificate) = (reader.u64()?, reader.part_owned(CERTIFICATE_BYTES_MAX)?);
        if node == 0 {
            return Err(reader.malformed("node 0", "the number of a node, from 1"));
        }
        Ok(Self { node, certificate, signature: reader.part_owned(SIGNATURE_BYTES_MAX)? })
    }
}

impl Signed {
    /// Its bytes: the statement, then the signature.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = self.statement.to_bytes();
        self.signature.write(&mut bytes);
        bytes.into()
    }

    /// Reads its bytes. The signature is not checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a signed statement", SIGNED_BYTES_MAX, b"", bytes)?;
        let (statement, signature) = (Statement::read(&mut reader)?, Signature::read(&mut reader)?);
        reader.end()?;
        Ok(Self { statement, signature })
    }
}
