//! Which certificates are trusted: those of servers, and those of clients.

use super::refusal::Refusal;
use ledger_base::hash::Hash;
use ledger_identity::msp::{Msp, Msps, Usage};
use ledger_identity::{Identity, IdentityError, Role};
use rustls::pki_types::CertificateDer;
use std::fmt;
use std::sync::{Arc, PoisonError, RwLock};

/// A stand-in for the organisation while only the fingerprint of its CA is known.
const UNKNOWN_ORGANISATION: &str = "unknown organisation";

/// The organisations that are trusted at the moment of a handshake: asked anew for each, so that organisations may join
/// and certificates may be revoked while connections come and go.
pub trait TrustSource: Send + Sync {
    /// The organisations of the network.
    fn msps(&self) -> Arc<Msps>;
    /// The wall clock, in microseconds since the UNIX epoch.
    fn now(&self) -> u64;
    /// Was this identity's certificate revoked?
    fn revoked(&self, identity: &Identity) -> bool;
}

/// The organisations of a network as one machine knows them: as they were at its enrolment, and as nodes of these have
/// told since. Clones of the [`Arc`] share it, so that connections which are made later know what was learnt.
#[derive(Debug)]
pub struct Trusted {
    enrolled: Arc<Msps>,
    learnt: RwLock<Option<Arc<Msps>>>,
}

impl Trusted {
    /// The knowledge from the enrolment and since.
    pub fn new(enrolled: Arc<Msps>, learnt: Option<Arc<Msps>>) -> Self {
        Self { enrolled, learnt: RwLock::new(learnt) }
    }

    /// Replaces what was learnt.
    pub fn learn(&self, learnt: Option<Arc<Msps>>) {
        *self.learnt.write().unwrap_or_else(PoisonError::into_inner) = learnt;
    }

    fn verify(&self, own: &[u8], now: u64) -> Result<Identity, IdentityError> {
        let verified = self.enrolled.verify_for(Usage::Server, own, &[], now);
        let learnt = self.learnt.read().unwrap_or_else(PoisonError::into_inner).clone();
        match (verified, learnt) {
            (Err(refused), Some(learnt)) => learnt.verify_for(Usage::Server, own, &[], now).map_err(|_| refused),
            (verified, _) => verified,
        }
    }
}

/// Which servers a client accepts. All of them must have the role node.
#[derive(Clone)]
pub enum ServerTrust {
    /// Nodes of these organisations, at the wall clock of the machine.
    Roots(Arc<Msps>),
    /// Nodes of the network as this machine knows it by now, at the wall clock of the machine.
    Learnt(Arc<Trusted>),
    /// Nodes of the network as it is at each handshake, without revoked ones: between nodes.
    Network(Arc<dyn TrustSource>),
    /// First contact: nodes that present, and are verified by, a CA with this SHA-256 fingerprint of its DER.
    Fingerprint([u8; 32]),
}

impl ServerTrust {
    /// Checks what a server presented: its certificate first. Where the organisations are known, only the authorities count
    /// that they have declared (decision 35): one that its root has revoked is none of these. `now` is the wall clock in microseconds since the UNIX
    /// epoch; [`ServerTrust::Network`] has its own. With [`ServerTrust::Fingerprint`] the organisation in the answer
    /// means nothing: no MSP is known yet that would name it.
    ///
    /// # Errors
    /// [`Refusal`]: why this server is not accepted.
    pub fn verify(&self, chain: &[CertificateDer<'_>], now: u64) -> Result<Identity, Refusal> {
        let (own, presented) = chain.split_first().ok_or(Refusal::NoCertificate)?;
        let identity = match self {
            Self::Roots(msps) => msps.verify_for(Usage::Server, own, &[], now)?,
            Self::Learnt(trusted) => trusted.verify(own, now)?,
            Self::Network(source) => {
                let found = source.msps().verify_for(Usage::Server, own, &[], source.now())?;
                if source.revoked(&found) {
                    return Err(Refusal::Revoked { id: found.id() });
                }
                found
            }
            Self::Fingerprint(wanted) => {
                let pinned = presented.iter().find(|found| Hash::of(&[found]).0 == *wanted);
                let Some(pinned) = pinned else {
                    return Err(Refusal::Fingerprint {
                        found: chain.iter().map(|found| Hash::of(&[found]).to_string()).collect(),
                        wanted: Hash(*wanted).to_string(),
                    });
                };
                let mut msps = Msps::new();
                msps.insert(Msp::new(UNKNOWN_ORGANISATION, &[pinned], &[[0; 0]; 0])?)?;
                msps.verify_for(Usage::Server, own, presented, now)?
            }
        };
        if identity.role != Role::Node {
            return Err(Refusal::NotANode { id: identity.id(), role: identity.role });
        }
        Ok(identity)
    }
}

impl fmt::Debug for ServerTrust {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Roots(_) => f.write_str("Roots"),
            Self::Learnt(_) => f.write_str("Learnt"),
            Self::Network(_) => f.write_str("Network"),
            Self::Fingerprint(wanted) => write!(f, "Fingerprint({})", Hash(*wanted)),
        }
    }
}

/// The identity of a connected client from the certificates that it presented (`peer_certificates()` of the
/// connection), checked anew: for a long connection, ask again. Only the authorities count that its organisation has declared.
/// `None` if it came without a certificate.
///
/// # Errors
/// [`Refusal`]: why the certificate is not accepted (any more).
pub fn client_identity(
    certificates: Option<&[CertificateDer<'_>]>,
    trust: &dyn TrustSource,
) -> Result<Option<Identity>, Refusal> {
    let Some(own) = certificates.and_then(<[_]>::first) else { return Ok(None) };
    let identity = trust.msps().verify_for(Usage::Client, own, &[], trust.now())?;
    if trust.revoked(&identity) {
        return Err(Refusal::Revoked { id: identity.id() });
    }
    Ok(Some(identity))
}
