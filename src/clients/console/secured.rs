//! The certificate of the console. That of the node is of no use: browsers refuse a certificate below an Ed25519 key for good, where they
//! only warn of one that nobody has signed.

use crate::process::config;
use crate::process::tls_files::TlsFiles;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::version::TLS13;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use std::net::SocketAddr;
use std::sync::Arc;

const FILES: TlsFiles = TlsFiles("console");

/// TLS for a console that listens there; none for plain HTTP, which stays on this machine. Without a certificate in the settings
/// it makes one for these names, which is good until the process ends.
///
/// # Errors
/// [`Code::BadFile`] if the certificate cannot be used.
pub(super) fn tls(
    settings: &config::Console,
    address: SocketAddr,
    names: &[String],
) -> Result<Option<ServerConfig>, Rejection> {
    let has_own = !settings.certificate.as_os_str().is_empty();
    if address.ip().is_loopback() && !has_own {
        return Ok(None);
    }
    let builder = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_protocol_versions(&[&TLS13])
        .map_err(|error| Rejection::new(Code::Internal, error.to_string()))?
        .with_no_client_auth();
    let (chain, key) = match has_own {
        true => (FILES.chain(&settings.certificate)?, FILES.key(&settings.key)?),
        false => made(names)?,
    };
    if let Some(shown) = chain.first() {
        tracing::info!(sha256 = %Hash::of(&[shown.as_ref()]), "TLS certificate for browsers");
    }
    let tls = builder.with_single_cert(chain, key);
    let mut tls = tls.map_err(|error| FILES.unusable(&settings.certificate, &error.to_string()))?;
    tls.alpn_protocols = vec![b"http/1.1".to_vec()];
    tls.send_tls13_tickets = 0;
    Ok(Some(tls))
}

/// A certificate that nobody has signed but its own key.
fn made(names: &[String]) -> Result<(Vec<CertificateDer<'static>>, PrivateKeyDer<'static>), Rejection> {
    let made = rcgen::generate_simple_self_signed(names);
    let made = made.map_err(|error| Rejection::new(Code::Internal, format!("cannot create a certificate: {error}")))?;
    let key = PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
    Ok((vec![made.cert.der().clone()], key.into()))
}
