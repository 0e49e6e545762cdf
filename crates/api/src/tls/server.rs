//! The server's side: who may connect to a node.

use super::identity::{TlsError, TlsIdentity};
use super::refusal::Refusal;
use super::trust::{TrustSource, client_identity};
use super::verifier::Verifier;
use super::{ALPN, VERSIONS, provider};
use ledger_identity::IdentityError;
use rustls::{CertificateError, ServerConfig};
use std::sync::Arc;

/// The settings of a node's server: clients of the network's organisations, or without a certificate. Their identity
/// comes from [`client_identity`].
///
/// # Errors
/// [`TlsError`] if rustls refuses the certificate or key.
pub fn server_config(identity: TlsIdentity, trust: Arc<dyn TrustSource>) -> Result<ServerConfig, TlsError> {
    let provider = provider();
    let verifier = Verifier::new(&provider, move |chain, _| {
        client_identity(Some(chain), trust.as_ref()).map(drop).map_err(|refusal| {
            tracing::info!(error = %refusal, "client certificate rejected");
            told(refusal)
        })
    });
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
