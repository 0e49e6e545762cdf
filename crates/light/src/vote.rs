//! A vote in an election of the leader, and the signature of the voter below it.

use crate::statement::Signature;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::key::SigningKey;

/// In front of the bytes that are signed, so that they are of no other kind.
const DOMAIN: &[u8] = b"ledgerd vote v1\0";

/// A voter elects a candidate. Its place is network, number of forced recoveries, term and voter. An honest voter gives one
/// vote for each place, ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Vote {
    /// Name of the network.
    pub network: Hash,
    /// Number of forced recoveries that the voter has executed.
    pub recoveries: u64,
    /// The term.
    pub term: u64,
    /// The node that is to lead in it.
    pub candidate: u64,
    /// The node that says so.
    pub voter: u64,
}

impl Vote {
    /// The bytes that are signed.
    pub fn to_bytes(&self) -> Vec<u8> {
        let numbers = [self.recoveries, self.term, self.candidate, self.voter].map(u64::to_be_bytes);
        [DOMAIN, &self.network.0, &numbers.concat()].concat()
    }

    /// Signs it as the voter, with this certificate.
    ///
    /// # Errors
    /// [`Code::Internal`](ledger_base::rejection::Code::Internal) if the system's randomness fails.
    pub fn sign(&self, certificate: Bytes, key: &SigningKey) -> Result<Signature, Rejection> {
        Signature::make(self.voter, certificate, key, &self.to_bytes())
    }
}
