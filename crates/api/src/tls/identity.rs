//! Our own side of a connection: certificate chain and private key.

use ledger::certificate::{CERTIFICATE_BYTES_MAX, Certificate};
use ledger::identity::IdentityError;
use ledger::key::{KEY_BYTES_MAX, KeyError, PublicKey, SigningKey};
use ledger::msp::PRESENTED_MAX;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use thiserror::Error;

/// Largest file of a certificate chain, in bytes of PEM: the certificate and those that may come along, in base64.
const CHAIN_BYTES_MAX: usize = (PRESENTED_MAX + 1) * CERTIFICATE_BYTES_MAX * 3 / 2;

/// Why our own certificate and key cannot be used.
#[derive(Debug, Error)]
pub enum TlsError {
    /// A file cannot be read.
    #[error("cannot read {what} {path:?}: {reason}; try checking the path and the permissions of the file")]
    File {
        /// What the file should hold.
        what: &'static str,
        /// The file.
        path: String,
        /// Why not.
        reason: String,
    },
    /// The text holds no usable certificate chain.
    #[error("found {found}, wanted a certificate chain in PEM (\"BEGIN CERTIFICATE\"), the own certificate first")]
    Chain {
        /// What is there instead.
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
pub struct TlsIdentity {
    /// The own certificate, its issuers, and for first contact the root.
    pub chain: Vec<CertificateDer<'static>>,
    /// The private key of the own certificate.
    pub key: PrivateKeyDer<'static>,
}

impl TlsIdentity {
    /// Takes a chain and a key, and checks that they belong together.
    ///
    /// # Errors
    /// [`TlsError::Chain`], [`TlsError::Certificate`], [`TlsError::Key`], [`TlsError::KeyMismatch`].
    pub fn new(chain: Vec<CertificateDer<'static>>, key: &SigningKey) -> Result<Self, TlsError> {
        let Some(own) = chain.first() else {
            return Err(TlsError::Chain { found: "no certificate".into() });
        };
        if chain.len() > PRESENTED_MAX + 1 {
            return Err(TlsError::Chain {
                found: format!("{} certificates (at most {} are read)", chain.len(), PRESENTED_MAX + 1),
            });
        }
        let wanted = PublicKey::from_spki(&Certificate::parse(own)?.public_key_info)?;
        let found = key.public_key();
        if found != wanted {
            return Err(TlsError::KeyMismatch { found: format!("{found:?}"), wanted: format!("{wanted:?}") });
        }
        let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.to_pkcs8_der().to_vec()));
        Ok(Self { chain, key })
    }

    /// Reads chain and key from PEM texts.
    ///
    /// # Errors
    /// As [`TlsIdentity::new`].
    pub fn from_pem(chain: &str, key: &str) -> Result<Self, TlsError> {
        let chain: Vec<_> = CertificateDer::pem_slice_iter(chain.as_bytes())
            .collect::<Result<_, _>>()
            .map_err(|error| TlsError::Chain { found: format!("text that is not PEM ({error})") })?;
        Self::new(chain, &SigningKey::from_pkcs8_pem(key)?)
    }

    /// Reads chain and key from PEM files.
    ///
    /// # Errors
    /// [`TlsError::File`], and as [`TlsIdentity::new`].
    pub fn from_pem_files(chain: &Path, key: &Path) -> Result<Self, TlsError> {
        let chain = read("certificate chain", chain, CHAIN_BYTES_MAX)?;
        let key = read("private key", key, KEY_BYTES_MAX)?;
        Self::from_pem(&chain, &key)
    }
}

impl Clone for TlsIdentity {
    fn clone(&self) -> Self {
        Self { chain: self.chain.clone(), key: self.key.clone_key() }
    }
}

impl fmt::Debug for TlsIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TlsIdentity").field("chain", &self.chain.len()).finish_non_exhaustive()
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
