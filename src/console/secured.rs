//! The certificate of the console. That of the node is of no use: browsers refuse a certificate below an Ed25519 key for good, where they
//! only warn of one that nobody has signed.

use crate::config;
use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::version::TLS13;
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use std::fs::File;
use std::io::Read;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

/// Largest file with a certificate or a key, bytes.
const FILE_BYTES_MAX: u64 = 64 * 1024;

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
        true => (chain(&settings.certificate)?, key(&settings.key)?),
        false => made(names)?,
    };
    if let Some(shown) = chain.first() {
        tracing::info!(sha256 = %Hash::of(&[shown.as_ref()]), "the certificate that browsers see");
    }
    let tls = builder.with_single_cert(chain, key);
    let mut tls = tls.map_err(|error| unusable(&settings.certificate, &error.to_string()))?;
    tls.alpn_protocols = vec![b"http/1.1".to_vec()];
    tls.send_tls13_tickets = 0;
    Ok(Some(tls))
}

/// A certificate that nobody has signed but its own key.
fn made(names: &[String]) -> Result<(Vec<CertificateDer<'static>>, PrivateKeyDer<'static>), Rejection> {
    let made = rcgen::generate_simple_self_signed(names);
    let made = made.map_err(|error| Rejection::new(Code::Internal, format!("no certificate can be made: {error}")))?;
    let key = PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
    Ok((vec![made.cert.der().clone()], key.into()))
}

fn chain(path: &Path) -> Result<Vec<CertificateDer<'static>>, Rejection> {
    let text = read(path)?;
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
    chain.map_err(|error| unusable(path, &error.to_string()))
}

fn key(path: &Path) -> Result<PrivateKeyDer<'static>, Rejection> {
    PrivateKeyDer::from_pem_slice(&read(path)?).map_err(|error| unusable(path, &error.to_string()))
}

fn read(path: &Path) -> Result<Vec<u8>, Rejection> {
    let mut text = Vec::new();
    let read = File::open(path).and_then(|file| file.take(FILE_BYTES_MAX).read_to_end(&mut text));
    read.map_err(|error| unusable(path, &error.to_string()))?;
    Ok(text)
}

fn unusable(path: &Path, found: &str) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot use {} for the console", path.display()))
        .found(found)
        .wanted("a certificate with its issuers in PEM, and its private key")
        .next("correct console.certificate and console.key in ledgerd.toml, or leave both out")
}
