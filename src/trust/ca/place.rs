//! The directory of a CA: how it is made, opened, and shared by processes.

use super::registry::{FILE, Registry};
use super::{CertificateAuthority, DIRECTORY, bad_argument, issue, key_failed, pem};
use ledger_base::durable::{PUBLIC_MODE, SECRET_MODE};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use ledger_identity::certificate::Certificate;
use ledger_identity::check_name;
use ledger_identity::key::{KEY_BYTES_MAX, KeyKind, SigningKey};
use ring::rand::SystemRandom;
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

pub(super) const ROOT_FILE: &str = "ca.pem";
pub(super) const KEY_FILE: &str = "ca.key";
/// Largest root that is read, in bytes of PEM.
pub(super) const ROOT_BYTES_MAX: usize = 32 * 1024;
/// In front of the name of a CA's directory that is being made.
const UNFINISHED: &str = ".new-";

impl CertificateAuthority {
    /// Founds the CA of an organisation in a directory that does not exist yet; its root is valid for ten years.
    /// `now` is in microseconds since the UNIX epoch.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the directory exists, a bad name, a failing disk. A directory that was made is removed.
    pub fn create(directory: &Path, organisation: &str, kind: KeyKind, now: u64) -> Result<Self, Rejection> {
        check_organisation(organisation)?;
        let key = SigningKey::generate(kind, &SystemRandom::new()).map_err(key_failed)?;
        let root = issue::root(organisation, &key, now)?;
        Self::install(directory, organisation, &key, &root)
    }

    /// Puts a key and root that exist into a directory that does not: all of it or nothing, whatever crashes.
    ///
    /// # Errors
    /// As [`CertificateAuthority::create`].
    pub fn install(directory: &Path, organisation: &str, key: &SigningKey, root: &[u8]) -> Result<Self, Rejection> {
        check_organisation(organisation)?;
        if fs::symlink_metadata(directory).is_ok() {
            return Err(Rejection::new(Code::BadFile, format!("{} exists already", directory.display()))
                .wanted("a directory that does not exist yet, for this CA")
                .next("choose another directory; a CA is never overwritten"));
        }
        let parent = directory.parent().unwrap_or_else(|| Path::new("."));
        let unfinished = parent.join(format!("{UNFINISHED}{organisation}"));
        remove(&unfinished)?;
        let written = || {
            ledger_base::durable::create_directory(&unfinished)?;
            ledger_base::durable::create(&unfinished.join(KEY_FILE), key.to_pkcs8_pem().as_bytes(), SECRET_MODE)?;
            ledger_base::durable::create(&unfinished.join(ROOT_FILE), pem(&[root]).as_bytes(), PUBLIC_MODE)?;
            Registry::new(organisation).stage(&unfinished)?.publish()?;
            ledger_base::durable::rename(&unfinished, directory)?;
            Self::open(directory)
        };
        written().inspect_err(|_| {
            let _ = fs::remove_dir_all(&unfinished);
        })
    }

    /// Opens the CA in a directory.
    ///
    /// # Errors
    /// [`Code::BadFile`] if a file is missing, the key may be read by others, or key and root do not belong together;
    /// [`Code::Corrupt`] if the registered names cannot be read.
    pub fn open(directory: &Path) -> Result<Self, Rejection> {
        let _turn = lock(directory)?;
        let key_path = directory.join(KEY_FILE);
        check_secret(
            &key_path,
            "if others may have read it, create a new CA: docs/operations.md, \"The CA of an \
                                 organisation\"",
        )?;
        let bad = |path: &Path, found: String| {
            Rejection::new(Code::BadFile, format!("{} is not usable", path.display()))
                .found(found)
                .next("restore the directory from a copy, or ledgerd ca restore FILE --config ledgerd.toml")
        };
        let text = ledger_base::durable::read(&key_path, KEY_BYTES_MAX)?;
        let key = SigningKey::from_pkcs8_pem(&String::from_utf8_lossy(&text))
            .map_err(|error| bad(&key_path, error.to_string()))?;
        let root_path = directory.join(ROOT_FILE);
        let root = CertificateDer::from_pem_slice(&ledger_base::durable::read(&root_path, ROOT_BYTES_MAX)?)
            .map_err(|error| bad(&root_path, error.to_string()))?
            .to_vec();
        let certificate = Certificate::parse(&root).map_err(|error| bad(&root_path, error.to_string()))?;
        if certificate.public_key_info != key.public_key().to_spki() {
            return Err(bad(&root_path, "the certificate of another key than ca.key".into()));
        }
        let stamp = Stamp::of(directory)?;
        let registry = Registry::load(directory)?;
        check_organisation(&registry.organisation)?;
        Ok(Self {
            directory: directory.to_owned(),
            key,
            root,
            registry,
            stamp,
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
        carried(data)?.iter().map(|name| Self::open(&data.join(DIRECTORY).join(name))).collect()
    }
}

/// The organisations of which a node has a CA's directory.
pub(crate) fn carried(data: &Path) -> Result<Vec<String>, Rejection> {
    let directory = data.join(DIRECTORY);
    let read = |error: io::Error| ledger_base::durable::failed("read", &directory, &error);
    if fs::symlink_metadata(&directory).is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
        return Ok(Vec::new());
    }
    let entries = fs::read_dir(&directory).map_err(read)?.collect::<Result<Vec<_>, _>>().map_err(read)?;
    let directories = entries.iter().filter(|entry| entry.path().is_dir());
    let mut names: Vec<_> = directories.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.retain(|name| !name.starts_with('.'));
    names.sort_unstable();
    Ok(names)
}

/// Removes the directory of a CA, if it is there.
///
/// # Errors
/// The directory, and what the system says.
pub(crate) fn remove(directory: &Path) -> Result<(), Rejection> {
    match fs::remove_dir_all(directory) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(ledger_base::durable::failed("remove", directory, &error))
        }
        _ => Ok(()),
    }
}

/// Which file `identities.json` is: it is never changed, only replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stamp {
    inode: u64,
    length: u64,
    changed: (i64, i64),
}

impl Stamp {
    pub(super) fn of(directory: &Path) -> Result<Self, Rejection> {
        let path = directory.join(FILE);
        let file = fs::metadata(&path).map_err(|error| ledger_base::durable::failed("read", &path, &error))?;
        Ok(Self { inode: file.ino(), length: file.len(), changed: (file.mtime(), file.mtime_nsec()) })
    }
}

/// Opens a CA's directory and waits for its lock: who has it is the only one that changes the CA, and has it for moments.
pub(super) fn lock(directory: &Path) -> Result<File, Rejection> {
    let file = File::open(directory).map_err(|error| ledger_base::durable::failed("open CA", directory, &error))?;
    file.lock().map_err(|error| ledger_base::durable::failed("lock CA", directory, &error))?;
    Ok(file)
}

/// A private key that others may read is no secret any more.
///
/// # Errors
/// [`Code::BadFile`] with the file, its mode, and what to do; `then` says what else, should somebody have read it.
pub(crate) fn check_secret(path: &Path, then: &str) -> Result<(), Rejection> {
    let found =
        fs::metadata(path).map_err(|error| ledger_base::durable::failed("read", path, &error))?.permissions().mode();
    if found & 0o077 == 0 {
        return Ok(());
    }
    Err(Rejection::new(Code::BadFile, format!("the private key {} is accessible to other users", path.display()))
        .found(format!("mode {:04o}", found & 0o7777))
        .wanted("mode 0600: its owner alone")
        .next(format!("chmod 600 {}; {then}", shell::path(path))))
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
