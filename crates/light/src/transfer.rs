//! The word of a leader that hands its leadership over, and its signature below it.

use crate::statement::Signature;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_identity::key::SigningKey;

/// In front of the bytes that are signed, so that they are of no other kind.
const DOMAIN: &[u8] = b"ledgerd transfer v1\0";

/// A leader hands over to a voter, which may stand for election in spite of the leader's lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Name of the network.
    pub network: Hash,
    /// Number of forced recoveries before.
    pub recoveries: u64,
    /// The term of the leader.
    pub term: u64,
    /// The leader.
    pub leader: u64,
    /// The node that is to lead next.
    pub to: u64,
}

impl Transfer {
    /// The bytes that are signed.
    pub fn to_bytes(&self) -> Vec<u8> {
        let numbers = [self.recoveries, self.term, self.leader, self.to].map(u64::to_be_bytes);
        [DOMAIN, &self.network.0, &numbers.concat()].concat()
    }

    /// Signs it as the leader, with this certificate.
    ///
    /// # Errors
    /// [`Code::Internal`](ledger_base::rejection::Code::Internal) if the system's randomness fails.
    pub fn sign(&self, certificate: Bytes, key: &SigningKey) -> Result<Signature, Rejection> {
        Signature::make(self.leader, certificate, key, &self.to_bytes())
    }
}
