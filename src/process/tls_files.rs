//! TLS from files of an operator: a certificate with its key, and the authorities of clients.

use ledger_base::rejection::{Code, Rejection};
use rustls::server::WebPkiClientVerifier;
use rustls::server::danger::ClientCertVerifier;
use rustls::{RootCertStore, crypto::CryptoProvider};
use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// Largest of these files, bytes.
const FILE_BYTES_MAX: u64 = 64 * 1024;

/// The files of a section of the configuration, such as `console`.
#[derive(Clone, Copy)]
pub(crate) struct TlsFiles(pub(crate) &'static str);

impl TlsFiles {
    /// The certificates of a file, in their order.
    ///
    /// # Errors
    /// [`Code::BadFile`] if there is none that can be read.
    pub(crate) fn chain(self, path: &Path) -> Result<Vec<CertificateDer<'static>>, Rejection> {
        let text = self.read(path)?;
        let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
        let chain = chain.map_err(|error| self.unusable(path, &error.to_string()))?;
        if chain.is_empty() { Err(self.unusable(path, "no certificate")) } else { Ok(chain) }
    }

    /// The private key of a file.
    ///
    /// # Errors
    /// As [`TlsFiles::chain`].
    pub(crate) fn key(self, path: &Path) -> Result<PrivateKeyDer<'static>, Rejection> {
        PrivateKeyDer::from_pem_slice(&self.read(path)?).map_err(|error| self.unusable(path, &error.to_string()))
    }

    /// Accepts clients whose certificates come from the authorities of a file, and nobody else.
    ///
    /// # Errors
    /// As [`TlsFiles::chain`].
    pub(crate) fn clients(
        self,
        path: &Path,
        provider: Arc<CryptoProvider>,
    ) -> Result<Arc<dyn ClientCertVerifier>, Rejection> {
        let mut roots = RootCertStore::empty();
        for authority in self.chain(path)? {
            roots.add(authority).map_err(|error| self.unusable(path, &error.to_string()))?;
        }
        let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build();
        verifier.map_err(|error| self.unusable(path, &error.to_string()))
    }

    /// The refusal of a file.
    pub(crate) fn unusable(self, path: &Path, found: &str) -> Rejection {
        let Self(section) = self;
        Rejection::new(Code::BadFile, format!("cannot use {} for [{section}]", path.display()))
            .found(found)
            .wanted("certificates in PEM, with their issuers, and the private key of the first one")
            .next(format!("correct the files that [{section}] names, or omit them"))
    }

    fn read(self, path: &Path) -> Result<Vec<u8>, Rejection> {
        let mut text = Vec::new();
        let read = File::open(path).and_then(|file| file.take(FILE_BYTES_MAX).read_to_end(&mut text));
        read.map_err(|error| self.unusable(path, &error.to_string()))?;
        Ok(text)
    }
}
