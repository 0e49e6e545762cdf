//! Our own side of a connection: certificate chain and private key.

use super::provider;
use ledger_base::hash::Hash;
use ledger_identity::IdentityError;
use ledger_identity::certificate::{CERTIFICATE_BYTES_MAX, Certificate};
use ledger_identity::key::{KEY_BYTES_MAX, KeyError, PublicKey, SigningKey};
use ledger_identity::msp::PRESENTED_MAX;
use rustls::SignatureScheme;
use rustls::client::ResolvesClientCert;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};
use thiserror::Error;

/// Largest file of a certificate chain, in bytes of PEM: the certificate and those that may come along, in base64.
const CHAIN_BYTES_MAX: usize = (PRESENTED_MAX + 1) * CERTIFICATE_BYTES_MAX * 3 / 2;

/// Why our own certificate and key cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TlsError {
    /// A file cannot be read.
    #[error("cannot read {what} {path:?}: {reason}; try checking the path and the permissions of the file")]
    File {
        /// The wanted content of the file.
        what: &'static str,
        /// The file.
        path: String,
        /// Why not.
        reason: String,
    },
    /// The content of a file cannot be used.
    #[error("{path}: {reason}")]
    In {
        /// The file.
        path: String,
        /// Why not.
        reason: Box<TlsError>,
    },
    /// Certificate and key in two files do not belong together.
    #[error("{key} is not the private key of the certificate in {chain}; try the key that was made for it")]
    FilesMismatch {
        /// The file of the key.
        key: String,
        /// The file of the certificate.
        chain: String,
    },
    /// The text holds no usable certificate chain.
    #[error("found {found}, wanted a certificate chain in PEM (\"BEGIN CERTIFICATE\"), the own certificate first")]
    Chain {
        /// The content that was found.
        found: String,
    },
    /// A certificate of the chain cannot be read.
    #[error(transparent)]
    Certificate(#[from] IdentityError),
    /// The key cannot be used.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// The key is not the one of the certificate.
    #[error(
        "found a private key of {found}, wanted the one of the certificate: {wanted}; try the key that was made for it"
    )]
    KeyMismatch {
        /// The public half of the private key.
        found: String,
        /// The public key in the certificate.
        wanted: String,
    },
    /// rustls refuses the settings.
    #[error("TLS cannot be set up: {0}")]
    Configuration(#[from] rustls::Error),
}

/// A certificate chain (the own certificate first) with its private key.
///
/// Clones share it: after [`TlsIdentity::renew`] all of them show the new certificate in their next handshakes, and
/// connections that exist stay. So a renewed certificate needs no restart.
#[derive(Clone)]
pub struct TlsIdentity {
    current: Arc<RwLock<Arc<Own>>>,
}

/// The certificate and the key of a [`TlsIdentity`] at the moment.
pub struct Own {
    /// The own certificate, its issuers, and for first contact the root.
    pub chain: Vec<CertificateDer<'static>>,
    /// The private key of the own certificate.
    pub key: Arc<SigningKey>,
    /// SHA-256 of the own certificate: the creator in transactions.
    pub creator: Hash,
    /// Both as rustls wants them.
    certified: Arc<CertifiedKey>,
}

impl TlsIdentity {
    /// Takes a chain and a key, and checks that they belong together.
    ///
    /// # Errors
    /// [`TlsError::Chain`], [`TlsError::Certificate`], [`TlsError::Key`], [`TlsError::KeyMismatch`].
    pub fn new(chain: Vec<CertificateDer<'static>>, key: Arc<SigningKey>) -> Result<Self, TlsError> {
        let wanted = own_key(&chain)?;
        let found = key.public_key();
        if found != wanted {
            return Err(TlsError::KeyMismatch { found: format!("{found:?}"), wanted: format!("{wanted:?}") });
        }
        let der = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.to_pkcs8_der().to_vec()));
        let signer = provider().key_provider.load_private_key(der)?;
        let certified = Arc::new(CertifiedKey::new(chain.clone(), signer));
        let creator = Hash::of(&[chain.first().map(AsRef::as_ref).unwrap_or_default()]);
        Ok(Self { current: Arc::new(RwLock::new(Arc::new(Own { chain, key, creator, certified }))) })
    }

    /// Reads chain and key from PEM texts. Of several keys the one of the certificate is taken. A renewal replaces two
    /// files one after the other; meanwhile the old key and the new one stand together in one of them.
    ///
    /// # Errors
    /// As [`TlsIdentity::new`].
    pub fn from_pem(chain: &str, key: &str) -> Result<Self, TlsError> {
        let chain = in_pem(chain)?;
        let first = SigningKey::from_pkcs8_pem(key)?;
        let wanted = own_key(&chain)?;
        let others = PrivatePkcs8KeyDer::pem_slice_iter(key.as_bytes())
            .filter_map(|section| SigningKey::from_pkcs8_der(section.ok()?.secret_pkcs8_der()).ok());
        let own = others.into_iter().find(|other| other.public_key() == wanted).unwrap_or(first);
        Self::new(chain, Arc::new(own))
    }

    /// Reads chain and key from PEM files.
    ///
    /// # Errors
    /// [`TlsError::File`], [`TlsError::FilesMismatch`], and as [`TlsIdentity::new`] with the file that it is about.
    pub fn from_pem_files(chain: &Path, key: &Path) -> Result<Self, TlsError> {
        let named = |path: &Path| path.display().to_string();
        let chain_text = read("certificate chain", chain, CHAIN_BYTES_MAX)?;
        let key_text = read("private key", key, KEY_BYTES_MAX)?;
        Self::from_pem(&chain_text, &key_text).map_err(|error| match error {
            TlsError::KeyMismatch { .. } => TlsError::FilesMismatch { key: named(key), chain: named(chain) },
            TlsError::Key(_) if in_pem(&chain_text).and_then(|chain| own_key(&chain)).is_ok() => {
                TlsError::In { path: named(key), reason: error.into() }
            }
            other => TlsError::In { path: named(chain), reason: other.into() },
        })
    }

    /// The certificate and key of this moment.
    pub fn own(&self) -> Arc<Own> {
        Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Shows another certificate from the next handshake on, here and in all clones.
    pub fn renew(&self, other: &Self) {
        let renewed = other.own();
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = renewed;
    }
}

impl Own {
    /// The own certificate in DER.
    pub fn certificate(&self) -> &[u8] {
        self.chain.first().map(AsRef::as_ref).unwrap_or_default()
    }
}

/// The certificates of a text in PEM.
fn in_pem(chain: &str) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    CertificateDer::pem_slice_iter(chain.as_bytes())
        .collect::<Result<_, _>>()
        .map_err(|error| TlsError::Chain { found: format!("text that is not PEM ({error})") })
}

/// The public key in the own certificate, the first of a chain.
fn own_key(chain: &[CertificateDer<'_>]) -> Result<PublicKey, TlsError> {
    let Some(own) = chain.first() else {
        return Err(TlsError::Chain { found: "no certificate".into() });
    };
    if chain.len() > PRESENTED_MAX + 1 {
        return Err(TlsError::Chain {
            found: format!("{} certificates (at most {} are read)", chain.len(), PRESENTED_MAX + 1),
        });
    }
    Ok(PublicKey::from_spki(&Certificate::parse(own)?.public_key_info)?)
}

impl ResolvesServerCert for TlsIdentity {
    fn resolve(&self, _client: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(Arc::clone(&self.own().certified))
    }
}

impl ResolvesClientCert for TlsIdentity {
    fn resolve(&self, _roots: &[&[u8]], _schemes: &[SignatureScheme]) -> Option<Arc<CertifiedKey>> {
        Some(Arc::clone(&self.own().certified))
    }

    fn has_certs(&self) -> bool {
        true
    }
}

impl fmt::Debug for TlsIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TlsIdentity").field("chain", &self.own().chain.len()).finish_non_exhaustive()
    }
}

fn read(what: &'static str, path: &Path, bytes_max: usize) -> Result<String, TlsError> {
    let refuse = |reason: String| TlsError::File { what, path: path.display().to_string(), reason };
    let file = File::open(path).map_err(|error| refuse(error.to_string()))?;
    let limit = u64::try_from(bytes_max).unwrap_or(u64::MAX).saturating_add(1);
    let mut text = String::new();
    file.take(limit).read_to_string(&mut text).map_err(|error| refuse(error.to_string()))?;
    if text.len() > bytes_max {
        return Err(refuse(format!("found more than {bytes_max} bytes, wanted at most {bytes_max}")));
    }
    Ok(text)
}
