//! Evidence: one file that proves who signed a transaction, and where it stands, to somebody who has only the genesis.
//!
//! It holds the way from the genesis to a certificate of a block, and the headers from the block of the transaction to that one.
//! The Merkle path of the transaction leads to the first of them (docs/format.md has each byte).
//!
//! The verdict has a way of its own to that certificate: over the effects of the same blocks ([`ledger_light::digest`]).

mod check;

pub use check::{Proved, Verdict};

use crate::block::Header;
use crate::headers::{HEADERS_BYTES_MAX, HEADERS_MAX, read_headers, write_headers};
use crate::transaction::TRANSACTION_BYTES_MAX;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::CERTIFICATE_BYTES_MAX;
use ledger_light::codec::{Reader, put};
use ledger_light::digest::PROVED_VERDICT_BYTES_MAX;
use ledger_light::governance::CHANGE_BYTES_MAX;
use ledger_light::merkle::{PATH_BYTES_MAX, Path};
use ledger_light::proof::PROOF_BYTES_MAX;
use ledger_light::{Change, Proof, ProvedVerdict};

const DOMAIN: &[u8] = b"ledgerd evidence v1\0";
const LINK_DOMAIN: &[u8] = b"ledgerd evidence link v1\0";
/// Longest file.
pub const EVIDENCE_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Longest link.
pub const LINK_BYTES_MAX: usize = LINK_DOMAIN.len()
    + 4 * 4
    + TRANSACTION_BYTES_MAX
    + CERTIFICATE_BYTES_MAX
    + PATH_BYTES_MAX
    + HEADERS_BYTES_MAX
    + PROVED_VERDICT_BYTES_MAX
    + PROOF_BYTES_MAX;

/// The content of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Evidence {
    /// The way from the genesis, as a node shows it, up to the certified block and not beyond.
    pub steps: Vec<Step>,
    /// From the transaction to the certificate.
    pub link: Link,
}

/// A step of the way: changes of who governs, and a proof behind them, if it has one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Step {
    /// In order of heights.
    pub changes: Vec<Change>,
    /// Of a block that is not before them.
    pub proof: Option<Proof>,
}

/// From a transaction to a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Link {
    /// Its bytes as they were signed.
    pub transaction: Bytes,
    /// The certificate of its creator, DER.
    pub certificate: Bytes,
    /// The way from it to the root of its block.
    pub path: Path,
    /// The headers from its block to the certified one. Each follows the one before.
    pub headers: Vec<Header>,
    /// Its verdict.
    pub verdict: ProvedVerdict,
    /// The certificate of the last block, with its ground.
    pub proof: Proof,
}

impl Link {
    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = LINK_DOMAIN.to_vec();
        put(&mut bytes, &self.transaction);
        put(&mut bytes, &self.certificate);
        put(&mut bytes, &self.path.to_bytes());
        write_headers(&mut bytes, &self.headers);
        self.verdict.write(&mut bytes);
        put(&mut bytes, &self.proof.to_bytes());
        bytes.into()
    }

    /// Reads its bytes. Nothing is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("the link of evidence", LINK_BYTES_MAX, LINK_DOMAIN, bytes)?;
        let transaction = reader.part_owned(TRANSACTION_BYTES_MAX)?;
        let certificate = reader.part_owned(CERTIFICATE_BYTES_MAX)?;
        let path = Path::from_bytes(reader.part(PATH_BYTES_MAX)?)?;
        let headers = read_headers(&mut reader)?;
        if headers.is_empty() {
            return Err(reader.malformed("no headers", &format!("1 to {HEADERS_MAX}")));
        }
        let verdict = ProvedVerdict::read(&mut reader)?;
        let proof = Proof::from_bytes(reader.part(PROOF_BYTES_MAX)?)?;
        reader.end()?;
        Ok(Self { transaction, certificate, path, headers, verdict, proof })
    }
}

impl Evidence {
    /// Its bytes. The last 32 are a hash of all others, so that no damage goes unnoticed.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        bytes.extend_from_slice(&(self.steps.len() as u32).to_be_bytes());
        for Step { changes, proof } in &self.steps {
            bytes.extend_from_slice(&(changes.len() as u32).to_be_bytes());
            for change in changes {
                bytes.extend_from_slice(&change.height.to_be_bytes());
                put(&mut bytes, &change.to_bytes());
            }
            put(&mut bytes, &proof.as_ref().map(Proof::to_bytes).unwrap_or_default());
        }
        put(&mut bytes, &self.link.to_bytes());
        let end = Hash::of(&[&bytes]);
        bytes.extend_from_slice(&end.0);
        bytes.into()
    }

    /// Reads its bytes. Only that they are whole is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`], [`Code::Corrupt`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let content = bytes.len().checked_sub(size_of::<Hash>()).and_then(|end| bytes.split_at_checked(end));
        let (content, end) = content.unwrap_or((bytes, &[]));
        let mut reader = Reader::new("evidence", EVIDENCE_BYTES_MAX, DOMAIN, content)?;
        if Hash::from_slice(end) != Some(Hash::of(&[content])) {
            return Err(Rejection::new(Code::Corrupt, "the file was changed or is incomplete")
                .found("bytes that do not match the hash at their end")
                .wanted("the bytes as they were written")
                .next("copy the file again, or create it again: ledgerctl prove TX"));
        }
        let mut steps = Vec::new();
        for _ in 0..reader.u32()? {
            let mut changes = Vec::new();
            for _ in 0..reader.u32()? {
                let height = reader.u64()?;
                changes.push(Change::from_bytes(height, reader.part(CHANGE_BYTES_MAX)?)?);
            }
            let proof = Some(reader.part(PROOF_BYTES_MAX)?).filter(|proof| !proof.is_empty());
            steps.push(Step { changes, proof: proof.map(Proof::from_bytes).transpose()? });
        }
        let link = Link::from_bytes(reader.part(LINK_BYTES_MAX)?)?;
        reader.end()?;
        Ok(Self { steps, link })
    }
}
