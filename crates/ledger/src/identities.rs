//! The owners of signatures: certificates known to the ledger, verified once and remembered.

use crate::msp::{self, Due, certificate_key, revoked_key};
use crate::network::FoundingOrganisation;
use crate::transaction::Transaction;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::key::KeyKind;
use ledger_identity::msp::Msps;
use ledger_storage::state::{Overlay, StateRead};
use quick_cache::unsync::Cache;
use std::sync::{Arc, PoisonError, RwLock};

/// Most identities kept in memory.
const CACHED_MAX: usize = 10_000;

/// Signatures that are checked together: more of them are hardly cheaper, and one that does not verify spoils it for
/// all.
const TOGETHER_MAX: usize = 64;
/// One is cheaper alone.
const TOGETHER_MIN: usize = 2;

/// The network's organisations and the identities verified against them.
///
/// A remembered identity changes no answer. A certificate is verified against the same organisations either way, and
/// one that has run out of a remembered path is verified again before it is refused.
pub(crate) struct Identities {
    trusted: RwLock<Trusted>,
}

struct Trusted {
    msps: Arc<Msps>,
    known: Cache<Hash, Arc<Identity>>,
    /// Which authorities have to publish a new revocation list until when, so that their members are not refused.
    due: Arc<Due>,
}

impl Trusted {
    fn read(state: &dyn StateRead) -> Result<Self, Rejection> {
        Self::of(&msp::organisations(state)?, Arc::new(msp::due(state)?))
    }

    fn of(organisations: &[FoundingOrganisation], due: Arc<Due>) -> Result<Self, Rejection> {
        let mut msps = Msps::new();
        for organisation in organisations {
            msps.insert(organisation.msp()?)?;
        }
        Ok(Self { msps: Arc::new(msps), known: Cache::new(CACHED_MAX), due })
    }
}

impl Identities {
    /// Reads the organisations that the state holds.
    pub(crate) fn read(state: &dyn StateRead) -> Result<Self, Rejection> {
        Ok(Self { trusted: RwLock::new(Trusted::read(state)?) })
    }

    /// The same with other organisations, as the transactions of a block so far have left them.
    pub(crate) fn with(&self, organisations: &[FoundingOrganisation]) -> Result<Self, Rejection> {
        let due = Arc::clone(&self.trusted.read().unwrap_or_else(PoisonError::into_inner).due);
        Ok(Self { trusted: RwLock::new(Trusted::of(organisations, due)?) })
    }

    /// Reads the organisations again, after a block has changed them or their revocation lists.
    pub(crate) fn reload(&self, state: &dyn StateRead) -> Result<(), Rejection> {
        let read = Trusted::read(state)?;
        *self.trusted.write().unwrap_or_else(PoisonError::into_inner) = read;
        Ok(())
    }

    /// The organisations.
    pub(crate) fn msps(&self) -> Arc<Msps> {
        Arc::clone(&self.trusted.read().unwrap_or_else(PoisonError::into_inner).msps)
    }

    /// Does somebody's organisation refuse its members, because an authority has not published its revocation list in time?
    pub(crate) fn check_current(&self, identity: &Identity, at: u64) -> Result<(), Rejection> {
        self.trusted.read().unwrap_or_else(PoisonError::into_inner).due.check(identity, at)
    }

    /// The creator of a transaction, valid at that time, not revoked, and not refused by their own organisation. If the ledger
    /// did not know the certificate, it is answered as well, to be written.
    pub(crate) fn creator(
        &self,
        transaction: &Transaction,
        overlay: &Overlay,
        at: u64,
    ) -> Result<(Arc<Identity>, Option<Bytes>), Rejection> {
        let fingerprint = transaction.creator();
        let (identity, new) = match self.remembered(&fingerprint, at) {
            // Remembered from an admission: the ledger itself may not have the certificate yet.
            Some(identity) if overlay.get(&certificate_key(&fingerprint)).is_some() => (identity, None),
            remembered => {
                let (der, new) = certificate(transaction, overlay, &fingerprint)?;
                let identity = match remembered {
                    Some(identity) => identity,
                    None => self.verify(&der, at)?,
                };
                (identity, new.then_some(der))
            }
        };
        check_revoked(&identity, overlay)?;
        if !msp::publishes_list(transaction) {
            self.check_current(&identity, at)?;
        }
        Ok((identity, new))
    }

    /// The records of a certificate that the ledger does not know yet, to be written with it at this time. Only of
    /// organisations whose CAs are not ours: of the others every certificate is registered.
    pub(crate) fn seen(&self, identity: &Identity, time: u64) -> Result<Option<[(Bytes, Bytes); 2]>, Rejection> {
        let trusted = self.trusted.read().unwrap_or_else(PoisonError::into_inner);
        let is_imported = trusted.msps.get(&identity.organisation).is_some_and(|msp| msp.units().is_some());
        is_imported.then(|| msp::seen(identity, time)).transpose()
    }

    /// Those of the transactions, by what they are given with, whose signatures are seen to verify when they are
    /// checked together. Nothing is said of the others: each has to be checked by itself.
    pub(crate) fn verify_together<'a, T>(
        &self,
        transactions: impl Iterator<Item = (T, &'a Transaction)>,
        at: u64,
    ) -> Vec<T> {
        let mut verified = Vec::new();
        // The hash of a long one costs more than what is saved, and it may be signed by its id.
        let short = transactions.filter(|(_, transaction)| !transaction.is_long());
        let mut known = short.filter_map(|(which, transaction)| {
            let identity = self.remembered(&transaction.creator(), at)?;
            (identity.public_key.kind() == KeyKind::Ed25519).then_some((which, (transaction, identity)))
        });
        loop {
            let (which, signed): (Vec<_>, Vec<_>) = known.by_ref().take(TOGETHER_MAX).unzip();
            match signed.len() {
                0 => return verified,
                TOGETHER_MIN.. if Transaction::verify_together(&signed) => verified.extend(which),
                _ => {}
            }
        }
    }

    /// The identity of a certificate that was verified before; nothing is verified now.
    pub(crate) fn known(&self, fingerprint: &Hash) -> Option<Arc<Identity>> {
        let trusted = self.trusted.read().unwrap_or_else(PoisonError::into_inner);
        trusted.known.get(fingerprint).map(Arc::clone)
    }

    fn remembered(&self, fingerprint: &Hash, at: u64) -> Option<Arc<Identity>> {
        let trusted = self.trusted.read().unwrap_or_else(PoisonError::into_inner);
        trusted.known.get(fingerprint).filter(|identity| identity.check_validity(at).is_ok()).map(Arc::clone)
    }

    fn verify(&self, der: &[u8], at: u64) -> Result<Arc<Identity>, Rejection> {
        let msps = self.msps();
        let identity = Arc::new(msps.verify(der, &[], at)?);
        let mut trusted = self.trusted.write().unwrap_or_else(PoisonError::into_inner);
        if Arc::ptr_eq(&trusted.msps, &msps) {
            trusted.known.insert(Hash(identity.fingerprint), Arc::clone(&identity));
        }
        Ok(identity)
    }
}

/// Refuses an identity whose organisation was removed, or has lost the authority that vouched for it. For callers whose
/// certificate was verified when they connected; a transaction's is verified against the organisations as they are anyway.
pub(crate) fn check_organisation(identity: &Identity, msps: &Msps) -> Result<(), Rejection> {
    let organisation = &identity.organisation;
    match msps.get(organisation) {
        Some(msp) if msp.standing().contains(&identity.issuer) => Ok(()),
        Some(_) => {
            Err(Rejection::new(Code::Untrusted, format!("the certificate of {} is no longer trusted", identity.id()))
                .found(format!("a certificate of a CA that {organisation} removed"))
                .wanted(format!("a certificate of a current CA of {organisation}"))
                .next(format!("ask an admin of {organisation}")))
        }
        None => Err(Rejection::new(
            Code::Untrusted,
            format!("{} belongs to no organisation of this network", identity.id()),
        )
        .found(format!("{organisation}, which was removed"))),
    }
}

/// Refuses an identity whose certificate was revoked, by itself or with its name.
pub(crate) fn check_revoked(identity: &Identity, overlay: &Overlay) -> Result<(), Rejection> {
    msp::check_barred(identity, overlay)?;
    match overlay.get(&revoked_key(&identity.revocation_key())) {
        None => Ok(()),
        Some(_) if active(Mutation::SkipTheRevocationCheck) => Ok(()),
        Some(_) => Err(Rejection::new(Code::Revoked, format!("the certificate of {} was revoked", identity.id()))
            .found(format!("serial {}", hex::encode(&identity.serial)))
            .wanted("a certificate that its organisation has not revoked".to_owned())
            .next(format!("ask an admin of {} and enrol again", identity.organisation))),
    }
}

/// The creator's certificate, and whether the ledger lacks it.
fn certificate(transaction: &Transaction, overlay: &Overlay, fingerprint: &Hash) -> Result<(Bytes, bool), Rejection> {
    if let Some(der) = overlay.get(&certificate_key(fingerprint)) {
        return Ok((der, false));
    }
    match transaction.certificate() {
        Some(der) if Hash::of(&[der]) == *fingerprint => Ok((der.clone(), true)),
        Some(der) => Err(Rejection::new(Code::UnknownCreator, "the attached certificate is not the creator's")
            .found(format!("certificate {}", Hash::of(&[der])))
            .wanted(format!("certificate {fingerprint}"))),
        None => Err(Rejection::new(Code::UnknownCreator, "the creator's certificate is not on the ledger yet")
            .found(format!("creator {fingerprint} without a certificate"))
            .wanted("the certificate in the field \"certificate\" of the transaction".to_owned())),
    }
}
