//! Reading and replacing the files of contexts.
//!
//! A context is written as a new directory `.NAME.new`, synced, and then changes places with the old one in one step.
//! Where the file system knows no such step, the old one waits as `.NAME.old` in between: whatever a crash leaves
//! behind, [`finish_replacement`] sees one complete context. One program at a time does this: see [`super::lock`].

use ledger_base::durable::SECRET_MODE;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use std::fs::{self, DirBuilder, File};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::Path;

pub(super) const SETTINGS: &str = "context.toml";
pub(super) const CERTIFICATE: &str = "certificate.pem";
pub(super) const KEY: &str = "key.pem";
pub(super) const MSPS: &str = "msps.json";
/// The network as it was learnt since the enrolment; may be missing.
pub(super) const NODES: &str = "nodes.json";

/// The secret half of the key with which the identity reads confidential services; may be missing.
pub(super) const READING: &str = "reading.key";

/// Largest file of a context that is read, in bytes.
const FILE_BYTES_MAX: u64 = 4 * 1024 * 1024;
const DIRECTORY_MODE: u32 = 0o700;
/// The permissions of others.
const OTHERS: u32 = 0o077;

/// A file that cannot be used, and what is wrong with it.
pub(crate) fn bad_file(path: &Path, found: impl Into<String>) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot use {}", path.display())).found(found)
}

/// Refuses to write what would not be read.
pub(super) fn check_length(path: &Path, text: &str) -> Result<(), Rejection> {
    if u64::try_from(text.len()).unwrap_or(u64::MAX) > FILE_BYTES_MAX {
        return Err(bad_file(path, format!("{} bytes", text.len())).wanted(format!("at most {FILE_BYTES_MAX} bytes")));
    }
    Ok(())
}

/// Reads a text file of limited size.
pub(super) fn read(path: &Path) -> Result<String, Rejection> {
    let fault = |error: std::io::Error| {
        bad_file(path, error.to_string())
            .wanted("the file of a stored context")
            .next("enrol again, or restore the file")
    };
    let mut text = String::new();
    let mut file = File::open(path).map_err(fault)?.take(FILE_BYTES_MAX + 1);
    let length = file.read_to_string(&mut text).map_err(fault)?;
    if u64::try_from(length).unwrap_or(u64::MAX) > FILE_BYTES_MAX {
        return Err(bad_file(path, format!("more than {FILE_BYTES_MAX} bytes")).wanted("a file of a context"));
    }
    Ok(text)
}

/// Reads a file that only its owner may read; refuses one that others can.
pub(super) fn read_secret(path: &Path) -> Result<String, Rejection> {
    if let Ok(metadata) = fs::metadata(path) {
        let mode = metadata.permissions().mode() & 0o777;
        if mode & OTHERS != 0 {
            return Err(bad_file(path, format!("mode {mode:04o}: other users can read or change the key"))
                .wanted(format!("mode {SECRET_MODE:04o}"))
                .next(format!("chmod 600 {}, and enrol again if others may have read it", shell::path(path))));
        }
    }
    read(path)
}

/// The certificates of a PEM text; at least one.
pub(super) fn certificates(path: &Path, text: &str) -> Result<Vec<CertificateDer<'static>>, Rejection> {
    let found = CertificateDer::pem_slice_iter(text.as_bytes()).collect::<Result<Vec<_>, _>>();
    match found {
        Ok(chain) if !chain.is_empty() => Ok(chain),
        Ok(_) => Err(bad_file(path, "no certificate").wanted("PEM with \"BEGIN CERTIFICATE\"")),
        Err(error) => Err(bad_file(path, error.to_string()).wanted("PEM with \"BEGIN CERTIFICATE\"")),
    }
}

/// Certificates as PEM text.
pub(super) fn pem(chain: &[CertificateDer<'_>]) -> String {
    let sections: Vec<_> = chain.iter().map(|der| pem::Pem::new("CERTIFICATE", der.as_ref())).collect();
    pem::encode_many_config(&sections, pem::EncodeConfig::new().set_line_ending(pem::LineEnding::LF))
}

/// The context that a directory entry stands for: itself, or one whose replacement was cut off.
pub(super) fn finished_name(entry: &str) -> Option<&str> {
    match entry.strip_prefix('.') {
        None => Some(entry),
        Some(rest) => rest.strip_suffix(".old"),
    }
}

/// Brings a context back whose replacement was cut off between the two renames.
pub(super) fn finish_replacement(contexts: &Path, name: &str) -> Result<(), Rejection> {
    let (current, old) = (contexts.join(name), contexts.join(format!(".{name}.old")));
    if current.exists() || !old.exists() {
        return Ok(());
    }
    match fs::rename(&old, &current) {
        // Somebody else was quicker.
        Err(_) if current.exists() => Ok(()),
        done => done.map_err(|error| bad_file(&old, error.to_string())),
    }
}

/// Writes the directory `name` below `contexts` with these files: all of them or none.
pub(super) fn replace_directory(contexts: &Path, name: &str, files: &[(&str, String)]) -> Result<(), Rejection> {
    let at = |path: &Path| {
        let path = path.to_owned();
        move |error: std::io::Error| unwritable(&path, &error)
    };
    finish_replacement(contexts, name)?;
    let current = contexts.join(name);
    let (new, old) = (contexts.join(format!(".{name}.new")), contexts.join(format!(".{name}.old")));
    for leftover in [&new, &old] {
        remove_directory(leftover)?;
    }
    DirBuilder::new().mode(DIRECTORY_MODE).create(&new).map_err(at(&new))?;
    let written = files
        .iter()
        .try_for_each(|(file, content)| ledger_base::durable::create(&new.join(file), content.as_bytes(), SECRET_MODE));
    if let Err(refused) = written.and_then(|()| ledger_base::durable::sync_directory(&new)) {
        // A full disk gets back what the half of a context took.
        let _kept = remove_directory(&new);
        return Err(advised(refused));
    }
    if current.exists() {
        // Other programs see the one or the other, never none.
        if renameat_with(CWD, &new, CWD, &current, RenameFlags::EXCHANGE).is_ok() {
            ledger_base::durable::sync_directory(contexts).map_err(advised)?;
            return remove_directory(&new);
        }
        ledger_base::durable::rename(&current, &old).map_err(advised)?;
    }
    ledger_base::durable::rename(&new, &current).map_err(advised)?;
    remove_directory(&old)
}

/// Writes one file: the new content or the old one, never a part.
pub(super) fn replace_file(directory: &Path, name: &str, content: &str) -> Result<(), Rejection> {
    create_directories(directory)?;
    replace_file_in(directory, name, content)
}

/// As [`replace_file`], in a directory that must exist: one that was removed meanwhile does not come back.
pub(super) fn replace_file_in(directory: &Path, name: &str, content: &str) -> Result<(), Rejection> {
    ledger_base::durable::replace(&directory.join(name), content.as_bytes(), SECRET_MODE).map_err(advised)
}

/// Makes a directory, and those above it.
pub(super) fn create_directories(path: &Path) -> Result<(), Rejection> {
    ledger_base::durable::create_directory(path).map_err(advised)
}

pub(super) fn remove_directory(path: &Path) -> Result<(), Rejection> {
    match fs::remove_dir_all(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(unwritable(path, &error)),
        _ => Ok(()),
    }
}

/// The same refusal with the advice for contexts.
fn advised(refused: Rejection) -> Rejection {
    refused
        .code(Code::BadFile)
        .wanted("a place to store a context")
        .next("check the owner and the free space of the directory, or set LEDGERD_HOME to another one")
}

/// A failed operation on the files of contexts.
pub(crate) fn unwritable(path: &Path, error: &std::io::Error) -> Rejection {
    advised(ledger_base::durable::failed("write", path, error))
}
