//! Names that were registered at this machine, and certificates that were issued here before the ledger knew of them:
//! the file `identities.json`. Registrations of admins over the network stand on the ledger and never here.

use super::secret::OneTimeSecret;
use ledger_base::durable::{SECRET_MODE, Staged};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Role;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Name of the file.
pub(super) const FILE: &str = "identities.json";
/// Most names of one CA. The file is rewritten with every change, so it has to stay small.
pub const IDENTITIES_MAX: usize = 10_000;
/// Most certificates of one name that are kept; beyond it the expired ones are forgotten.
pub const CERTIFICATES_MAX: usize = 64;
/// Largest file that is written and read, in bytes.
const FILE_BYTES_MAX: usize = 128 * 1024 * 1024;
/// Version of the file's format.
const VERSION: u32 = 1;

/// The registered names of one organisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Registry {
    /// Version of the format.
    version: u32,
    /// The organisation of the CA.
    pub(super) organisation: String,
    /// The names.
    pub(super) identities: BTreeMap<String, Registered>,
}

/// A registered name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registered {
    /// Its role.
    pub role: Role,
    /// The attributes of its next certificate.
    pub attributes: BTreeMap<String, String>,
    /// Since when, microseconds since the UNIX epoch.
    pub registered: u64,
    /// The secret with which it may enrol, or by which it did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) secret: Option<OneTimeSecret>,
    /// The certificates it has received, oldest first.
    pub certificates: Vec<IssuedCertificate>,
}

/// A certificate that was issued, as `list` and `revoke` need it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IssuedCertificate {
    /// Serial number: the content of the DER INTEGER.
    #[serde(with = "hex::serde")]
    pub serial: Vec<u8>,
    /// SHA-256 of the issuer's distinguished name, as a revocation names it.
    pub issuer: Hash,
    /// SHA-256 of the certificate.
    pub fingerprint: Hash,
    /// Start of validity, microseconds since the UNIX epoch.
    pub not_before: u64,
    /// Last valid microsecond since the UNIX epoch.
    pub not_after: u64,
    /// The certificate, DER.
    #[serde(with = "hex::serde")]
    pub der: Vec<u8>,
}

impl Registry {
    /// Nobody yet.
    pub(super) fn new(organisation: &str) -> Self {
        Self { version: VERSION, organisation: organisation.to_owned(), identities: BTreeMap::new() }
    }

    /// Reads the file. A missing or damaged one is refused: an empty registry would let names be registered anew.
    pub(super) fn load(directory: &Path) -> Result<Self, Rejection> {
        let path = directory.join(FILE);
        let content = ledger_base::durable::read(&path, FILE_BYTES_MAX)?;
        let damaged = |found: String| {
            Rejection::new(Code::Corrupt, format!("{} cannot be read, so enrolment does not work here", path.display()))
                .found(found)
                .wanted("the registry of names, as this CA wrote it")
                .next("restore the file from a copy")
        };
        let registry: Self = serde_json::from_slice(&content).map_err(|error| damaged(error.to_string()))?;
        if registry.version != VERSION {
            return Err(damaged(format!("version {} of the format instead of {VERSION}", registry.version)));
        }
        Ok(registry)
    }

    /// Writes the file beside the one in use.
    pub(super) fn stage(&self, directory: &Path) -> Result<Staged, Rejection> {
        let content = serde_json::to_vec_pretty(self)
            .map_err(|error| Rejection::new(Code::Internal, format!("identities cannot be written: {error}")))?;
        // What could not be read again must not be written.
        if content.len() > FILE_BYTES_MAX {
            return Err(Rejection::new(Code::LimitExceeded, "the CA's registered names take too much space")
                .found(format!("{} bytes", content.len()))
                .wanted(format!("at most {FILE_BYTES_MAX} bytes"))
                .next("use shorter attributes"));
        }
        ledger_base::durable::stage(&directory.join(FILE), &content, SECRET_MODE)
    }
}

impl Registered {
    /// When its secret was made and until when it can be used, if it still can.
    pub fn open_secret(&self, now: u64) -> Option<(u64, u64)> {
        self.secret.as_ref().filter(|secret| secret.is_open(now)).map(|secret| (secret.made, secret.expires))
    }

    /// The certificate with this fingerprint, DER, if it is kept.
    pub(super) fn der(&self, fingerprint: &Hash) -> Option<&[u8]> {
        let kept = self.certificates.iter().find(|issued| issued.fingerprint == *fingerprint)?;
        Some(kept.der.as_slice()).filter(|der| !der.is_empty())
    }

    /// Adds a certificate; forgets those that expired before `now` if there are too many.
    pub(super) fn add(&mut self, issued: IssuedCertificate, now: u64) -> Result<(), Rejection> {
        if self.certificates.len() >= CERTIFICATES_MAX {
            self.certificates.retain(|certificate| certificate.not_after >= now);
        }
        if self.certificates.len() >= CERTIFICATES_MAX {
            return Err(Rejection::new(Code::LimitExceeded, "this name has too many valid certificates")
                .wanted(format!("at most {CERTIFICATES_MAX}"))
                .next("register another name, or wait until certificates expire"));
        }
        self.certificates.push(issued);
        Ok(())
    }
}
