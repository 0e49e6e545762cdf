//! The owners of signatures, by the robot's own check against the network's organisations.

use std::{collections::BTreeSet, sync::Arc};

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_hash::Hash;
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use quick_cache::unsync::Cache;

use super::Refused;
use crate::service::Revoked;

/// Most identities remembered; those that are forgotten are shown anew.
const IDENTITIES_MAX: usize = 4096;
/// Most revocations remembered; beyond it nothing passes any more, because one could be missing.
const REVOKED_MAX: usize = 100_000;

/// Verified certificates, and revoked ones.
#[derive(Debug)]
pub(super) struct Identities {
    msps: Arc<Msps>,
    known: Cache<Hash, Arc<Identity>>,
    revoked: BTreeSet<Vec<u8>>,
    overflown: bool,
}

impl Identities {
    pub(super) fn new(msps: Arc<Msps>) -> Self {
        Self { msps, known: Cache::new(IDENTITIES_MAX), revoked: BTreeSet::new(), overflown: false }
    }

    /// The creator of a transaction, who signed it and is valid at `at` (microseconds) and not revoked.
    pub(super) fn creator(
        &mut self,
        transaction: &Transaction,
        shown: &Bytes,
        at: u64,
    ) -> Result<Arc<Identity>, Refused> {
        let fingerprint = transaction.creator();
        let identity = match self.known.get(&fingerprint).filter(|known| known.check_validity(at).is_ok()) {
            Some(known) => Arc::clone(known),
            None => {
                let der = [Some(shown), transaction.certificate()]
                    .into_iter()
                    .flatten()
                    .find(|der| Hash::of(&[der]) == fingerprint)
                    .ok_or(Refused::UnknownCreator)?;
                let identity = self.msps.verify(der, &[], at).map_err(|_| Refused::Untrusted)?;
                let identity = Arc::new(identity);
                self.known.insert(fingerprint, Arc::clone(&identity));
                identity
            }
        };
        if self.overflown || self.revoked.contains(&identity.revocation_key()) {
            return Err(Refused::Revoked);
        }
        transaction.verify(&identity.public_key).map_err(|_| Refused::BadSignature)?;
        Ok(identity)
    }

    /// Takes note of a revocation; answers with what [`Identity::revocation_key`] of the revoked says.
    pub(super) fn revoke(&mut self, revoked: &Revoked) -> Option<Vec<u8>> {
        let serial = hex::decode(&revoked.serial).ok()?;
        let key = [&revoked.issuer.0[..], &serial].concat();
        if self.revoked.len() < REVOKED_MAX {
            self.revoked.insert(key.clone());
        } else if !self.revoked.contains(&key) {
            self.overflown = true;
        }
        Some(key)
    }
}
