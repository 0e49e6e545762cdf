//! The server's side: who may connect to a node.

use super::identity::{TlsError, TlsIdentity};
use super::refusal::Refusal;
use super::trust::{TrustSource, client_identity};
use super::{ALPN, VERSIONS, provider};
use ledger_identity::IdentityError;
use rustls::client::danger::HandshakeSignatureValid;
use rustls::crypto::{CryptoProvider, verify_tls13_signature};
use rustls::pki_types::{CertificateDer, UnixTime};
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::{
    CertificateError, DigitallySignedStruct, DistinguishedName, PeerIncompatible, ServerConfig, SignatureScheme,
};
use std::fmt;
use std::sync::Arc;

/// The settings of a node's server: clients of the network's organisations, or without a certificate. Their identity
/// comes from [`client_identity`].
///
/// # Errors
/// [`TlsError`] if rustls refuses the certificate or key.
pub fn server_config(identity: TlsIdentity, trust: Arc<dyn TrustSource>) -> Result<ServerConfig, TlsError> {
    let provider = provider();
    let verifier = ClientVerifier { trust, provider: Arc::clone(&provider) };
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(VERSIONS)?
        .with_client_cert_verifier(Arc::new(verifier))
        .with_cert_resolver(Arc::new(identity));
    config.alpn_protocols = vec![ALPN.to_vec()];
    config.send_tls13_tickets = 0;
    Ok(config)
}

/// The refusal as the error whose alert tells the client most. Details that an alert cannot carry are in the node's log
/// only.
fn told(refusal: Refusal) -> rustls::Error {
    let error = match &refusal {
        Refusal::Revoked { .. } => CertificateError::Revoked,
        Refusal::Identity(IdentityError::Expired { .. }) => CertificateError::Expired,
        Refusal::Identity(IdentityError::NotYetValid { .. }) => CertificateError::NotValidYet,
        Refusal::Identity(IdentityError::Untrusted { .. }) => CertificateError::UnknownIssuer,
        _ => return refusal.into(),
    };
    rustls::Error::InvalidCertificate(error)
}

/// The server's check of a client that presents a certificate.
struct ClientVerifier {
    trust: Arc<dyn TrustSource>,
    provider: Arc<CryptoProvider>,
}

impl ClientCertVerifier for ClientVerifier {
    fn client_auth_mandatory(&self) -> bool {
        false
    }

    /// No hints: the organisations may change between two handshakes, and clients have one certificate anyway.
    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        own: &CertificateDer<'_>,
        presented: &[CertificateDer<'_>],
        _now: UnixTime,
    ) -> Result<ClientCertVerified, rustls::Error> {
        let chain: Vec<_> = std::iter::once(own).chain(presented).cloned().collect();
        match client_identity(Some(&chain), self.trust.as_ref()) {
            Ok(_) => Ok(ClientCertVerified::assertion()),
            Err(refusal) => {
                tracing::info!(error = %refusal, "a client's certificate is refused");
                Err(told(refusal))
            }
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

impl fmt::Debug for ClientVerifier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ClientVerifier")
    }
}
