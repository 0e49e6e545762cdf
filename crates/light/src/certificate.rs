//! Certificates: a statement that enough voters have signed. Not to be confused with the X.509 certificates of signers.

use crate::codec::Reader;
use crate::statement::{ENCLOSED_BYTES_MAX, STATEMENT_BYTES, Signature, Statement};
use crate::voters::Voters;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use std::collections::BTreeSet;

const DOMAIN: &[u8] = b"ledgerd certificate v1\0";
/// Most signatures: those of all voters before and after a change.
pub const SIGNATURES_MAX: usize = 128;
/// Longest encoding.
pub const CERTIFICATE_BYTES_MAX: usize = DOMAIN.len() + STATEMENT_BYTES + 4 + SIGNATURES_MAX * ENCLOSED_BYTES_MAX;

/// A statement, and the signatures of a majority of the voters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certificate {
    /// The statement.
    pub statement: Statement,
    /// In ascending order of nodes.
    pub signatures: Vec<Signature>,
}

impl Certificate {
    /// Its bytes.
    pub fn to_bytes(&self) -> Bytes {
        let mut bytes = DOMAIN.to_vec();
        bytes.extend_from_slice(&self.statement.to_bytes());
        bytes.extend_from_slice(&(self.signatures.len() as u32).to_be_bytes());
        self.signatures.iter().for_each(|signature| signature.write(&mut bytes));
        bytes.into()
    }

    /// Reads its bytes. No signature is checked.
    ///
    /// # Errors
    /// [`Code::TooLarge`], [`Code::Malformed`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a certificate of a block", CERTIFICATE_BYTES_MAX, DOMAIN, bytes)?;
        let (statement, count) = (Statement::read(&mut reader)?, reader.u32()? as usize);
        if count > SIGNATURES_MAX {
            return Err(reader.malformed(&format!("{count} signatures"), &format!("at most {SIGNATURES_MAX}")));
        }
        let signatures = (0..count).map(|_| Signature::read(&mut reader)).collect::<Result<Vec<_>, _>>()?;
        if !signatures.is_sorted_by(|one, next| one.node < next.node) {
            return Err(reader.malformed("signatures out of order", "ascending nodes, each of them once"));
        }
        reader.end()?;
        Ok(Self { statement, signatures })
    }

    /// Is this what enough voters of that network have signed? `voters` are those as of the block before. `identify` finds
    /// whose X.509 certificate this is at that time (microseconds since the UNIX epoch), by the organisations and the
    /// revocations as of the block before. [`Msps::verify`](ledger_identity::msp::Msps::verify) does it but for revocations.
    ///
    /// # Errors
    /// [`Code::WrongNetwork`], [`Code::Untrusted`] with what is missing, [`Code::BadSignature`], or what `identify` says.
    pub fn verify(
        &self,
        network: &Hash,
        voters: &Voters,
        mut identify: impl FnMut(&[u8], u64) -> Result<Identity, Rejection>,
    ) -> Result<(), Rejection> {
        if self.statement.network != *network {
            return Err(Rejection::new(Code::WrongNetwork, "a certificate is about a block of another network")
                .found(self.statement.network.to_string())
                .wanted(network.to_string()));
        }
        let mut signers = BTreeSet::new();
        if let Some(twice) = self.signatures.iter().find(|signature| !signers.insert(signature.node)) {
            return Err(Rejection::new(Code::Malformed, "a certificate has two signatures of one node")
                .found(format!("node {} twice", twice.node))
                .wanted("each node once"));
        }
        // Counting is cheap, so it comes first.
        voters.enough(&signers)?;
        // A signature that is not good counts for nothing, and spoils nothing.
        let (mut good, mut refused) = (BTreeSet::new(), None);
        for signature in &self.signatures {
            let identity = identify(&signature.certificate, self.statement.time);
            match identity.and_then(|identity| voters.check(&self.statement, signature, &identity)) {
                Ok(()) => drop(good.insert(signature.node)),
                Err(reason) => refused = refused.or(Some(reason)),
            }
        }
        voters.enough(&good).map_err(|few| refused.unwrap_or(few))
    }
}
