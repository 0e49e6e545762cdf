//! Checkpoints: where a reader was, to go on from later, or to compare with.

use crate::codec::{Reader, put};
use crate::governance::{CHANGE_BYTES_MAX, Change, Governance};
use crate::proof::{PROOF_BYTES_MAX, Proof};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};

const DOMAIN: &[u8] = b"ledgerd checkpoint v1\0";
/// Longest encoding.
pub const CHECKPOINT_BYTES_MAX: usize = DOMAIN.len() + 8 + CHANGE_BYTES_MAX + PROOF_BYTES_MAX;

/// The governance of a network after a certified block, with the proof of that block. Its reader believes its maker, so nobody
/// else may be able to change it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint {
    /// The governance after the block.
    pub governance: Governance,
    /// The proof of the block.
    pub proof: Proof,
}

impl Checkpoint {
    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        put(&mut bytes, &self.governance.all().to_bytes());
        put(&mut bytes, &self.proof.to_bytes());
        bytes.into()
    }

    /// Reads its bytes, and checks that it belongs together and is of that network.
    ///
    /// # Errors
    /// [`Code::WrongNetwork`]; [`Code::Untrusted`] if the paths of its proof lead nowhere; [`Code::TooLarge`],
    /// [`Code::Malformed`].
    pub fn from_bytes(network: &Hash, bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a checkpoint", CHECKPOINT_BYTES_MAX, DOMAIN, bytes)?;
        let (values, proof) = (reader.part(CHANGE_BYTES_MAX)?, reader.part(PROOF_BYTES_MAX)?);
        let (values, proof) = (values.to_vec(), Proof::from_bytes(proof)?);
        reader.end()?;
        let values = Change::from_bytes(proof.certificate.statement.height, &values)?;
        Self::of(network, values, proof)
    }

    /// Of all governing state after the block of this proof.
    ///
    /// # Errors
    /// As [`Checkpoint::from_bytes`].
    pub fn of(network: &Hash, values: Change, proof: Proof) -> Result<Self, Rejection> {
        let (statement, ground) = (&proof.certificate.statement, proof.ground()?);
        if statement.network != *network {
            return Err(Rejection::new(Code::WrongNetwork, "the checkpoint is of another network")
                .found(statement.network.to_string())
                .wanted(network.to_string())
                .next("take a checkpoint of this network"));
        }
        // In one form only: whoever compares two checkpoints compares their bytes.
        let ascending = values.writes.is_sorted_by(|(one, _), (next, _)| one < next);
        if !ascending || values.writes.iter().any(|(_, value)| value.is_none()) {
            return Err(Rejection::new(Code::Malformed, "the governing state of a checkpoint is not in its form")
                .found(format!("{} keys, out of order or without values", values.writes.len()))
                .wanted("ascending keys, each of them once and with a value")
                .next("take another checkpoint"));
        }
        let governance = Governance::of(values, (statement, ground));
        Ok(Self { governance, proof })
    }
}
