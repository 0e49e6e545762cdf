//! The servers that a client accepts, and the checks that both sides share.

use super::identity::{TlsError, TlsIdentity};
use super::refusal::Refusal;
use super::{ALPN, VERSIONS, provider};
use ledger_base::hash::Hash;
use ledger_identity::msp::{Msp, Msps, Usage};
use ledger_identity::{Identity, IdentityError, Role};
use rustls::client::Resumption;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, verify_tls13_signature};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{ClientConfig, DigitallySignedStruct, PeerIncompatible, SignatureScheme};
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

/// The settings of a client that accepts any node that `trust` accepts, with or without a certificate of its own.
/// The host name that rustls asks for is sent, but not checked.
///
/// # Errors
/// [`TlsError`] if rustls refuses the certificate or key.
pub fn client_config(identity: Option<TlsIdentity>, trust: ServerTrust) -> Result<ClientConfig, TlsError> {
    configure(identity, trust, None)
}

/// The settings of a client that shows nothing and accepts anybody: to hear from a server that was refused what it says
/// of itself. The answer is good for advice, and for nothing else.
pub(crate) fn unverified_config() -> Result<ClientConfig, TlsError> {
    let provider = provider();
    let builder = ClientConfig::builder_with_provider(Arc::clone(&provider))
        .with_protocol_versions(VERSIONS)?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(Anybody { provider }));
    let mut config = builder.with_no_client_auth();
    config.alpn_protocols = vec![ALPN.to_vec()];
    config.resumption = Resumption::disabled();
    Ok(config)
}

/// As [`client_config`], but accepts only the node `Org1/node1`; or `node1` of any organisation, for first contact.
///
/// # Errors
/// As [`client_config`].
pub fn client_config_expecting(
    identity: Option<TlsIdentity>,
    trust: ServerTrust,
    node: &str,
) -> Result<ClientConfig, TlsError> {
    configure(identity, trust, Some(node.to_owned()))
}

fn configure(
    identity: Option<TlsIdentity>,
    trust: ServerTrust,
    expected: Option<String>,
) -> Result<ClientConfig, TlsError> {
    let provider = provider();
    let verifier = ServerVerifier { trust, expected, provider: Arc::clone(&provider) };
    let builder = ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(VERSIONS)?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(verifier));
    let mut config = match identity {
        Some(identity) => builder.with_client_cert_resolver(Arc::new(identity)),
        None => builder.with_no_client_auth(),
    };
    config.alpn_protocols = vec![ALPN.to_vec()];
    config.resumption = Resumption::disabled();
    Ok(config)
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

/// The client's check of the server.
#[derive(Debug)]
struct ServerVerifier {
    trust: ServerTrust,
    /// `organisation/name` or only the name of the one node that is accepted.
    expected: Option<String>,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for ServerVerifier {
    fn verify_server_cert(
        &self,
        own: &CertificateDer<'_>,
        presented: &[CertificateDer<'_>],
        _host: &ServerName<'_>,
        _ocsp_response: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let chain: Vec<_> = std::iter::once(own).chain(presented).cloned().collect();
        let identity = self.trust.verify(&chain, now.as_secs().saturating_mul(1_000_000))?;
        match &self.expected {
            Some(wanted) if *wanted != identity.id() && *wanted != identity.name => {
                Err(Refusal::OtherNode { found: identity.id(), wanted: wanted.clone() }.into())
            }
            _ => Ok(ServerCertVerified::assertion()),
        }
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        Err(PeerIncompatible::Tls12NotOfferedOrEnabled.into())
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

/// Accepts every certificate.
#[derive(Debug)]
struct Anybody {
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for Anybody {
    fn verify_server_cert(
        &self,
        _own: &CertificateDer<'_>,
        _presented: &[CertificateDer<'_>],
        _host: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        Err(PeerIncompatible::Tls12NotOfferedOrEnabled.into())
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, certificate, signature, &self.provider.signature_verification_algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}
