//! The owners of signatures, by the robot's own check against the network's organisations.

use std::{collections::VecDeque, sync::Arc};

use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_identity::Identity;
use quick_cache::unsync::Cache;

use super::Refused;
use crate::{service::Revoked, standing::Members};

/// Most identities remembered; those that are forgotten are shown anew.
const IDENTITIES_MAX: usize = 4096;
/// Most certificates that wait to be used.
const SHOWN_MAX: usize = 256;
/// Most revocations that a node has told since the last standing. Beyond it the oldest are for the next standing to tell.
const TOLD_MAX: usize = 1024;

/// Verified certificates, and revoked ones.
#[derive(Debug)]
pub(super) struct Identities {
    members: Option<Members>,
    known: Cache<Hash, Arc<Identity>>,
    /// Certificates as a node has shown them: not verified yet.
    shown: Cache<Hash, Bytes>,
    /// Revocations that a node has told, and nobody else yet.
    told: VecDeque<Vec<u8>>,
}

impl Default for Identities {
    fn default() -> Self {
        let (known, shown) = (Cache::new(IDENTITIES_MAX), Cache::new(SHOWN_MAX));
        Self { members: None, known, shown, told: VecDeque::new() }
    }
}

impl Identities {
    /// Takes who governs now. The word of a node is forgotten: it is true by now, or it was never true.
    pub(super) fn replace(&mut self, members: &Members) {
        let same = self.members.as_ref().is_some_and(|known| Arc::ptr_eq(&known.msps, &members.msps));
        if !same {
            self.known.clear();
        }
        self.members = Some(members.clone());
        self.told.clear();
    }

    /// Keeps a certificate that a node shows, for a message to come: nodes show each of them once.
    pub(super) fn show(&mut self, certificate: &Bytes) {
        // A copy, so that it keeps nothing larger alive.
        self.shown.insert(Hash::of(&[certificate]), Bytes::copy_from_slice(certificate));
    }

    /// The creator of a transaction, who signed it and is valid at `at` (microseconds) and not revoked.
    pub(super) fn creator(
        &mut self,
        transaction: &Transaction,
        shown: &Bytes,
        at: u64,
    ) -> Result<Arc<Identity>, Refused> {
        let members = self.members.as_ref().ok_or(Refused::NoService)?;
        let fingerprint = transaction.creator();
        let identity = match self.known.get(&fingerprint).filter(|known| known.check_validity(at).is_ok()) {
            Some(known) => Arc::clone(known),
            None => {
                let der = [Some(shown), transaction.certificate()].into_iter().flatten();
                let der = der.chain(self.shown.get(&fingerprint)).find(|der| Hash::of(&[der]) == fingerprint);
                let der = der.ok_or(Refused::UnknownCreator)?;
                let identity = members.msps.verify(der, &[], at).map_err(|_| Refused::Untrusted)?;
                let identity = Arc::new(identity);
                self.known.insert(fingerprint, Arc::clone(&identity));
                identity
            }
        };
        if members.has_revoked(&identity) || self.told.contains(&identity.revocation_key()) {
            return Err(Refused::Revoked);
        }
        transaction.verify(&identity.public_key).map_err(|_| Refused::BadSignature)?;
        Ok(identity)
    }

    /// Takes note of a revocation that a node tells; answers with [`Identity::revocation_key`] of the revoked.
    pub(super) fn revoke(&mut self, revoked: &Revoked) -> Option<Vec<u8>> {
        let key = revoked.key()?;
        if self.told.len() >= TOLD_MAX {
            self.told.pop_front();
        }
        self.told.push_back(key.clone());
        Some(key)
    }
}
