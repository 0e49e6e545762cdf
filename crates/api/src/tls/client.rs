//! The client's side: which nodes it connects to.

use super::identity::{TlsError, TlsIdentity};
use super::refusal::Refusal;
use super::trust::ServerTrust;
use super::verifier::Verifier;
use super::{ALPN, VERSIONS, provider};
use rustls::ClientConfig;
use rustls::client::Resumption;
use std::sync::Arc;

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
        .with_custom_certificate_verifier(Arc::new(Verifier::new(&provider, |_, _| Ok(()))));
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
    let verifier = Verifier::new(&provider, move |chain, now| {
        let identity = trust.verify(chain, now)?;
        match &expected {
            Some(wanted) if *wanted != identity.id() && *wanted != identity.name => {
                Err(Refusal::OtherNode { found: identity.id(), wanted: wanted.clone() }.into())
            }
            _ => Ok(()),
        }
    });
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
