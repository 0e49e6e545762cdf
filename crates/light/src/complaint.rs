//! The complaint of a voter that a leader withholds a call, and its signature below it.

use crate::statement::Signature;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::key::SigningKey;

/// In front of the bytes that are signed, so that they are of no other kind.
const DOMAIN: &[u8] = b"ledgerd complaint v1\0";

/// A voter states that the leader of a term orders other things and withholds a control call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Complaint {
    /// Name of the network.
    pub network: Hash,
    /// Number of forced recoveries that the voter has executed.
    pub recoveries: u64,
    /// The term.
    pub term: u64,
    /// The leader of that term.
    pub leader: u64,
    /// The voter that complains.
    pub node: u64,
}

impl Complaint {
    /// The bytes that are signed.
    pub fn to_bytes(&self) -> Vec<u8> {
        let numbers = [self.recoveries, self.term, self.leader, self.node].map(u64::to_be_bytes);
        [DOMAIN, &self.network.0, &numbers.concat()].concat()
    }

    /// Signs it as the voter, with this certificate.
    ///
    /// # Errors
    /// [`Code::Internal`](ledger_base::rejection::Code::Internal) if the system's randomness fails.
    pub fn sign(&self, certificate: Bytes, key: &SigningKey) -> Result<Signature, Rejection> {
        Signature::make(self.node, certificate, key, &self.to_bytes())
    }
}
