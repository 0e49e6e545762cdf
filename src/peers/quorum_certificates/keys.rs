//! The node's key for statements and votes, and whose certificates are believed in those of others.

use bytes::Bytes;
use ledger::Ledger;
use ledger_api::tls::TlsIdentity;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use ledger_light::{Head, Signature, Signed, Statement, Transfer, Vote};
use ledger_replica::certifier::Signing;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Most identities that are remembered: those of all voters, and as many renewed ones.
const KNOWN_MAX: usize = 256;

/// Signs as this node, and finds who has signed.
pub(crate) struct Keys {
    me: u64,
    /// Follows the renewal of the certificate.
    identity: TlsIdentity,
    ledger: Arc<Ledger>,
    /// By the hash of the certificate.
    known: Mutex<HashMap<Hash, Found>>,
}

/// An identity, and the organisations by which it was found.
type Found = (Arc<Identity>, Arc<Msps>);

impl Keys {
    /// Of this node.
    pub(crate) fn new(me: u64, identity: TlsIdentity, ledger: Arc<Ledger>) -> Self {
        Self { me, identity, ledger, known: Mutex::default() }
    }

    fn find(&self, msps: &Arc<Msps>, certificate: &[u8], time: u64) -> Result<Arc<Identity>, Rejection> {
        let fingerprint = Hash::of(&[certificate]);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((identity, of)) = known.get(&fingerprint)
            && Arc::ptr_eq(of, msps)
            && identity.check_validity(time).is_ok()
        {
            return Ok(Arc::clone(identity));
        }
        let identity = Arc::new(msps.verify(certificate, &[], time)?);
        if known.len() >= KNOWN_MAX {
            known.clear();
        }
        known.insert(fingerprint, (Arc::clone(&identity), Arc::clone(msps)));
        Ok(identity)
    }
}

impl Signing for Keys {
    fn sign(&self, statement: &Statement) -> Result<Signed, Rejection> {
        let own = self.identity.own();
        statement.sign(self.me, Bytes::copy_from_slice(own.certificate()), &own.key)
    }

    fn sign_vote(&self, vote: &Vote) -> Result<Signature, Rejection> {
        let own = self.identity.own();
        vote.sign(Bytes::copy_from_slice(own.certificate()), &own.key)
    }

    fn sign_transfer(&self, transfer: &Transfer) -> Result<Signature, Rejection> {
        let own = self.identity.own();
        transfer.sign(Bytes::copy_from_slice(own.certificate()), &own.key)
    }

    fn sign_head(&self, head: &Head) -> Result<Signature, Rejection> {
        let own = self.identity.own();
        head.sign(Bytes::copy_from_slice(own.certificate()), &own.key)
    }

    fn identify(&self, msps: &Arc<Msps>, certificate: &[u8], time: u64) -> Result<Identity, Rejection> {
        let identity = self.find(msps, certificate, time)?;
        // By the newest state: a certificate that was revoked since is not believed either.
        if self.ledger.is_revoked(&Hash(identity.issuer), &identity.serial)? {
            return Err(Rejection::new(Code::Revoked, "a statement or a vote is signed with a revoked certificate")
                .found(identity.id())
                .wanted("a certificate that is not revoked")
                .next("renew the certificate of that node"));
        }
        Ok((*identity).clone())
    }
}
