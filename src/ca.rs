//! The certificate authority of one organisation: registers names, exchanges one-time secrets for certificates.
//!
//! | file in `<data>/ca/<Org>/` | content |
//! |---|---|
//! | `ca.pem` | the self-signed root: the organisation's verifying material |
//! | `ca.key` | its private key, PKCS #8, mode 0600 |
//! | `identities.json` | registered names, what is left of their secrets, and the certificates they received |
//!
//! `identities.json` is replaced as a whole and down to the disk before anything is answered. So a secret is used up
//! by one key, whatever crashes, and no certificate is out that the file does not know.

pub(crate) mod durable;
mod issue;
mod registry;
mod request;
mod secret;
#[cfg(test)]
mod tests;

pub use issue::DAY;
pub use registry::{CERTIFICATES_MAX, IDENTITIES_MAX, IssuedCertificate, Registered};
pub use request::REQUEST_BYTES_MAX;
pub(crate) use request::make as request;
pub use secret::{PRESENTED_BYTES_MAX, WRONG_TRIES_MAX};

use durable::{PUBLIC_MODE, SECRET_MODE};
use issue::Holder;
use ledger::certificate::{Certificate, encode_attributes};
use ledger::identity::{Role, check_name};
use ledger::key::{KEY_BYTES_MAX, KeyKind, PublicKey, SigningKey};
use ledger::{Code, Hash, Rejection};
use registry::Registry;
use ring::rand::SystemRandom;
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use secret::OneTimeSecret;
use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Shortest time between a name's last certificate and a renewal, in microseconds: each is a write to the disk.
pub const RENEWAL_PAUSE: u64 = 60 * 1_000_000;

/// The directory of the CAs that a node carries, in its data directory; one directory for each organisation.
pub const DIRECTORY: &str = "ca";
const ROOT_FILE: &str = "ca.pem";
const KEY_FILE: &str = "ca.key";
/// Largest root that is read, in bytes of PEM.
const ROOT_BYTES_MAX: usize = 32 * 1024;

/// The CA of one organisation. Whoever holds it is the only one: its directory is locked.
pub struct CertificateAuthority {
    directory: PathBuf,
    /// The open directory; its lock keeps a second process from losing our changes.
    _lock: File,
    key: SigningKey,
    root: Vec<u8>,
    registry: Registry,
    /// A change may or may not have reached the disk, so that nothing can be promised any more.
    poisoned: bool,
    /// For how long certificates are valid.
    certificate_days: u32,
    /// For how long secrets can be used.
    secret_days: u32,
}

/// An identity that was enrolled here, with its private key.
#[derive(Debug)]
pub struct Issued {
    /// The certificate, DER.
    pub certificate: Vec<u8>,
    /// The certificates above it, DER: the root.
    pub chain: Vec<Vec<u8>>,
    /// The private key.
    pub key: SigningKey,
}

impl CertificateAuthority {
    /// Days for which certificates are valid, unless [`CertificateAuthority::set_days`] says otherwise.
    pub const CERTIFICATE_DAYS: u32 = 365;
    /// Days for which secrets can be used, unless [`CertificateAuthority::set_days`] says otherwise.
    pub const SECRET_DAYS: u32 = 7;

    /// Founds the CA of an organisation in a directory that does not exist yet; its root is valid for ten years.
    /// `now` is in microseconds since the UNIX epoch, here and everywhere in this type.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the directory exists, a bad name, a failing disk. A directory that was made is removed.
    pub fn create(directory: &Path, organisation: &str, kind: KeyKind, now: u64) -> Result<Self, Rejection> {
        check_organisation(organisation)?;
        if fs::symlink_metadata(directory).is_ok() {
            return Err(Rejection::new(Code::BadFile, format!("{} exists already", directory.display()))
                .wanted("a directory that does not exist yet, for a new CA")
                .next("choose another directory; a CA is never overwritten"));
        }
        let key = SigningKey::generate(kind, &SystemRandom::new()).map_err(key_failed)?;
        let root = issue::root(organisation, &key, now)?;
        durable::create_directory(directory)?;
        let written = || {
            durable::create(&directory.join(KEY_FILE), key.to_pkcs8_pem().as_bytes(), SECRET_MODE)?;
            durable::create(&directory.join(ROOT_FILE), pem(&[&root]).as_bytes(), PUBLIC_MODE)?;
            Registry::new(organisation).stage(directory)?.publish()?;
            directory.parent().map_or(Ok(()), durable::sync_directory)?;
            Self::open(directory)
        };
        written().inspect_err(|_| {
            let _ = fs::remove_dir_all(directory);
        })
    }

    /// Opens the CA in a directory.
    ///
    /// # Errors
    /// [`Code::BadFile`] if a file is missing, the key may be read by others, key and root do not belong together,
    /// or somebody else has the CA open; [`Code::Corrupt`] if the registered names cannot be read.
    pub fn open(directory: &Path) -> Result<Self, Rejection> {
        let lock = lock(directory)?;
        let key_path = directory.join(KEY_FILE);
        check_secret(&key_path)?;
        let bad = |path: &Path, found: String| {
            Rejection::new(Code::BadFile, format!("{} is not usable", path.display()))
                .found(found)
                .next("restore the CA's directory from a copy")
        };
        let text = durable::read(&key_path, KEY_BYTES_MAX)?;
        let key = SigningKey::from_pkcs8_pem(&String::from_utf8_lossy(&text))
            .map_err(|error| bad(&key_path, error.to_string()))?;
        let root_path = directory.join(ROOT_FILE);
        let root = CertificateDer::from_pem_slice(&durable::read(&root_path, ROOT_BYTES_MAX)?)
            .map_err(|error| bad(&root_path, error.to_string()))?
            .to_vec();
        let certificate = Certificate::parse(&root).map_err(|error| bad(&root_path, error.to_string()))?;
        if certificate.public_key_info != key.public_key().to_spki() {
            return Err(bad(&root_path, "the certificate of another key than ca.key".into()));
        }
        let registry = Registry::load(directory)?;
        check_organisation(&registry.organisation)?;
        Ok(Self {
            directory: directory.to_owned(),
            _lock: lock,
            key,
            root,
            registry,
            poisoned: false,
            certificate_days: Self::CERTIFICATE_DAYS,
            secret_days: Self::SECRET_DAYS,
        })
    }

    /// Opens every CA that a node carries: the directories in `<data>/ca`. Most nodes carry none.
    ///
    /// # Errors
    /// As [`CertificateAuthority::open`], of the first one that cannot be opened.
    pub fn open_all(data: &Path) -> Result<Vec<Self>, Rejection> {
        let directory = data.join(DIRECTORY);
        let read = |error: std::io::Error| durable::failed("read", &directory, &error);
        if fs::symlink_metadata(&directory).is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound) {
            return Ok(Vec::new());
        }
        let entries = fs::read_dir(&directory).map_err(read)?.collect::<Result<Vec<_>, _>>().map_err(read)?;
        entries.iter().map(|entry| Self::open(&entry.path())).collect()
    }

    /// Sets for how many days certificates are valid and secrets can be used, from now on.
    pub fn set_days(&mut self, certificates: u32, secrets: u32) {
        (self.certificate_days, self.secret_days) = (certificates, secrets);
    }

    /// The organisation.
    pub fn organisation(&self) -> &str {
        &self.registry.organisation
    }

    /// The root certificate, DER.
    pub fn root(&self) -> &[u8] {
        &self.root
    }

    /// SHA-256 of the root certificate, which clients pin at first contact.
    pub fn fingerprint(&self) -> Hash {
        Hash::of(&[&self.root])
    }

    /// The registered names, in their order.
    pub fn identities(&self) -> impl Iterator<Item = (&str, &Registered)> {
        self.registry.identities.iter().map(|(name, registered)| (name.as_str(), registered))
    }

    /// One registered name.
    pub fn identity(&self, name: &str) -> Option<&Registered> {
        self.registry.identities.get(name)
    }

    /// Registers a name and answers with the one-time secret with which it may enrol. The secret is not kept.
    ///
    /// # Errors
    /// [`Code::AlreadyRegistered`], [`Code::BadArgument`] for names and attributes that no certificate could hold,
    /// [`Code::LimitExceeded`], a failing disk.
    pub fn register(
        &mut self,
        name: &str,
        role: Role,
        attributes: BTreeMap<String, String>,
        now: u64,
    ) -> Result<String, Rejection> {
        check_name(name).map_err(|error| bad_argument(&error.to_string()))?;
        check_attributes(&attributes)?;
        if let Some(known) = self.identity(name) {
            return Err(Rejection::new(
                Code::AlreadyRegistered,
                format!("{name} is already registered at {}", self.organisation()),
            )
            .found(format!("role {}, {} certificates", known.role, known.certificates.len()))
            .wanted("a new name")
            .next("choose another name, or ask for a new secret of this one (reissue)"));
        }
        if self.registry.identities.len() >= IDENTITIES_MAX {
            return Err(Rejection::new(Code::LimitExceeded, "no more names can be registered at this CA")
                .found(format!("{IDENTITIES_MAX} names"))
                .next("register the rest at another CA of the organisation"));
        }
        let (secret, text) = self.new_secret(now)?;
        let registered =
            Registered { role, attributes, registered: now, secret: Some(secret), certificates: Vec::new() };
        self.change(|registry| registry.identities.insert(name.to_owned(), registered))?;
        Ok(text)
    }

    /// A new secret for a registered name: after a lost secret, before a certificate expires, or, with new
    /// attributes, because its holder may do more or less from now on. An older secret is void at once.
    ///
    /// # Errors
    /// [`Code::NotFound`], [`Code::BadArgument`], a failing disk.
    pub fn reissue(
        &mut self,
        name: &str,
        attributes: Option<BTreeMap<String, String>>,
        now: u64,
    ) -> Result<String, Rejection> {
        if let Some(attributes) = &attributes {
            check_attributes(attributes)?;
        }
        let organisation = self.organisation();
        let mut registered = self.identity(name).cloned().ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("{name:?} is not registered at {organisation}"))
                .next("register it first")
        })?;
        let (secret, text) = self.new_secret(now)?;
        registered.secret = Some(secret);
        registered.attributes = attributes.unwrap_or(registered.attributes);
        self.change(|registry| registry.identities.insert(name.to_owned(), registered))?;
        Ok(text)
    }

    /// Exchanges a one-time secret and a signing request (PKCS #10, DER) for a certificate (DER). Of the request only
    /// the public key is used; name, role and attributes are as registered. Afterwards the secret is good for nothing
    /// but the same key again, in case the answer was lost.
    ///
    /// # Errors
    /// [`Code::EnrolmentRefused`], alike for an unknown name and a secret that is wrong, used, expired or void;
    /// [`Code::BadArgument`] for a bad request, which leaves the secret usable; a failing disk.
    pub fn enrol(&mut self, name: &str, secret: &str, request: &[u8], now: u64) -> Result<Vec<u8>, Rejection> {
        self.check_usable()?;
        if secret.len() > PRESENTED_BYTES_MAX {
            return Err(Self::refusal());
        }
        let usable = |secret: &OneTimeSecret| secret.is_usable(now);
        let Some(mut registered) =
            self.identity(name).filter(|known| known.secret.as_ref().is_some_and(usable)).cloned()
        else {
            return Err(Self::refusal());
        };
        if let Some(expected) = registered.secret.as_mut().filter(|expected| !expected.opens(secret, now)) {
            expected.count_wrong();
            self.change(|registry| registry.identities.insert(name.to_owned(), registered))?;
            return Err(Self::refusal());
        }
        let key = request::public_key(request)?;
        if !registered.secret.as_mut().is_some_and(|secret| secret.bind(&key)) {
            return Err(Self::refusal());
        }
        self.certify(name, registered, &key, now)
    }

    /// A new certificate for a name that has one that is still good, which the caller has verified. Of the request only
    /// the public key is used; name, role and attributes are as registered now.
    ///
    /// # Errors
    /// [`Code::NotFound`] if the name is not registered here, [`Code::WrongRole`] if it is registered for something
    /// else, [`Code::Overloaded`] within [`RENEWAL_PAUSE`] of the last certificate, [`Code::BadArgument`] for a bad
    /// request, a failing disk.
    pub fn renew(&mut self, name: &str, role: Role, request: &[u8], now: u64) -> Result<Vec<u8>, Rejection> {
        self.check_usable()?;
        let organisation = self.organisation();
        let registered = self.identity(name).cloned().ok_or_else(|| {
            Rejection::new(Code::NotFound, format!("{name:?} is not registered at the CA of {organisation}"))
                .next("ask an admin of the organisation to register it and to send a one-time secret")
        })?;
        if registered.role != role {
            return Err(Rejection::new(Code::WrongRole, format!("{name} is registered for something else"))
                .found(format!("a certificate with role {role}"))
                .wanted(format!("role {}", registered.role))
                .next("ask an admin of the organisation for a new one-time secret"));
        }
        let newest = registered.certificates.iter().map(IssuedCertificate::issued).max().unwrap_or_default();
        if now >= newest && now - newest < RENEWAL_PAUSE {
            return Err(Rejection::new(Code::Overloaded, format!("{name} has received a certificate just now"))
                .wanted(format!("a renewal at most once in {} s", RENEWAL_PAUSE / 1_000_000))
                .next("use that certificate, or try again in a minute"));
        }
        let key = request::public_key(request)?;
        self.certify(name, registered, &key, now)
    }

    /// Signs a certificate and remembers it.
    fn certify(
        &mut self,
        name: &str,
        mut registered: Registered,
        key: &PublicKey,
        now: u64,
    ) -> Result<Vec<u8>, Rejection> {
        let holder = Holder {
            organisation: self.organisation(),
            name,
            role: registered.role,
            attributes: &registered.attributes,
            key,
        };
        let der = issue::leaf(&self.root, &self.key, &holder, self.certificate_days, now)?;
        let certificate = Certificate::parse(&der)?;
        registered.add(
            IssuedCertificate {
                serial: certificate.serial,
                issuer: Hash::of(&[&certificate.issuer_name]),
                fingerprint: Hash::of(&[&der]),
                not_before: certificate.not_before,
                not_after: certificate.not_after,
            },
            now,
        )?;
        self.change(|registry| registry.identities.insert(name.to_owned(), registered))?;
        Ok(der)
    }

    /// Why enrolment is refused: the same words whatever is wrong, so that nobody learns which names exist.
    pub fn refusal() -> Rejection {
        Rejection::new(Code::EnrolmentRefused, "enrolment is refused")
            .found("a name and secret that do not belong together, or a secret that was used, has expired or is void")
            .wanted("a registered name (or ORGANISATION/NAME) and its unused one-time secret")
            .next("ask an admin of the organisation for a new secret")
    }

    /// Registers and enrols at once, with a key made here: for a node's own identity and a founder's first admins. A
    /// name that is registered with this role already receives another certificate, with these attributes.
    ///
    /// # Errors
    /// As [`CertificateAuthority::register`] and [`CertificateAuthority::enrol`].
    pub fn issue(
        &mut self,
        name: &str,
        role: Role,
        attributes: BTreeMap<String, String>,
        kind: KeyKind,
        now: u64,
    ) -> Result<Issued, Rejection> {
        let key = SigningKey::generate(kind, &SystemRandom::new()).map_err(key_failed)?;
        let secret = match self.identity(name) {
            Some(known) if known.role == role => self.reissue(name, Some(attributes), now)?,
            _ => self.register(name, role, attributes, now)?,
        };
        let certificate = self.enrol(name, &secret, &request::make(&key, name)?, now)?;
        Ok(Issued { certificate, chain: vec![self.root.clone()], key })
    }

    fn new_secret(&self, now: u64) -> Result<(OneTimeSecret, String), Rejection> {
        OneTimeSecret::generate(now.saturating_add(u64::from(self.secret_days) * DAY))
    }

    /// Changes the registered names on the disk, then in memory.
    fn change<T>(&mut self, change: impl FnOnce(&mut Registry) -> T) -> Result<(), Rejection> {
        self.check_usable()?;
        let mut changed = self.registry.clone();
        change(&mut changed);
        let staged = changed.stage(&self.directory)?;
        // Until the rename nothing has happened; after it only success says what the disk holds.
        self.poisoned = true;
        staged.publish()?;
        self.poisoned = false;
        self.registry = changed;
        Ok(())
    }

    fn check_usable(&self) -> Result<(), Rejection> {
        if !self.poisoned {
            return Ok(());
        }
        Err(Rejection::new(Code::DiskFailed, format!("the CA of {} has stopped", self.organisation()))
            .found("an earlier change that the disk did not confirm")
            .next("look at the disk, then restart the node"))
    }
}

impl Issued {
    /// The certificate and those above it, in PEM.
    pub fn chain_pem(&self) -> String {
        let chain: Vec<_> = std::iter::once(&self.certificate).chain(&self.chain).collect();
        pem(&chain)
    }
}

/// Certificates in PEM.
pub(crate) fn pem(ders: &[impl AsRef<[u8]>]) -> String {
    let sections: Vec<_> = ders.iter().map(|der| pem::Pem::new("CERTIFICATE", der.as_ref())).collect();
    pem::encode_many_config(&sections, pem::EncodeConfig::new().set_line_ending(pem::LineEnding::LF))
}

/// The name of an organisation is also the name of its CA's directory.
fn check_organisation(name: &str) -> Result<(), Rejection> {
    check_name(name).map_err(|error| bad_argument(&error.to_string()))?;
    if name.starts_with('.') {
        return Err(bad_argument(&format!(
            "found organisation {name:?}, wanted a name that does not start with a dot"
        )));
    }
    Ok(())
}

fn check_attributes(attributes: &BTreeMap<String, String>) -> Result<(), Rejection> {
    encode_attributes(attributes).map(|_| ()).map_err(|error| bad_argument(&error.to_string()))
}

/// Opens and locks the CA's directory.
fn lock(directory: &Path) -> Result<File, Rejection> {
    let file = File::open(directory).map_err(|error| durable::failed("open CA", directory, &error))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => {
            Err(Rejection::new(Code::BadFile, format!("the CA in {} is open elsewhere", directory.display()))
                .wanted("one process that changes it")
                .next("stop the other node, or register through it"))
        }
        Err(TryLockError::Error(error)) => Err(durable::failed("lock CA", directory, &error)),
    }
}

/// A private key that others may read is no secret any more.
fn check_secret(path: &Path) -> Result<(), Rejection> {
    let found = fs::metadata(path).map_err(|error| durable::failed("read", path, &error))?.permissions().mode();
    if found & 0o077 == 0 {
        return Ok(());
    }
    Err(Rejection::new(Code::BadFile, format!("the private key {} may be read by others", path.display()))
        .found(format!("mode {:04o}", found & 0o7777))
        .wanted("mode 0600")
        .next(format!("chmod 600 {}; if others may have read it, found the CA anew", path.display())))
}

fn bad_argument(found: &str) -> Rejection {
    Rejection::new(Code::BadArgument, "this cannot be registered").found(found)
}

fn key_failed(error: ledger::key::KeyError) -> Rejection {
    Rejection::new(Code::Internal, error.to_string())
}
