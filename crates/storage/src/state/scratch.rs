//! A copy of a directory in the system's directory for temporary files, which goes away with its value.

use ledger_base::durable::failed;
use ledger_base::rejection::Rejection;
use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process;

/// Most names that are tried.
const TRIES_MAX: u32 = 1000;
/// Only its owner reads it: it holds what the ledger holds.
const MODE: u32 = 0o700;

/// The copy.
pub(super) struct Scratch(PathBuf);

impl Scratch {
    /// Copies a directory with the directories in it.
    ///
    /// # Errors
    /// The fault of the file system, such as no space.
    pub(super) fn copy_of(directory: &Path) -> Result<Self, Rejection> {
        let place = Self(made().map_err(|error| failed("make directory", &std::env::temp_dir(), &error))?);
        copy(directory, &place.0).map_err(|error| {
            failed("copy", directory, &error).next(format!(
                "free disk space in {}, or name another directory in TMPDIR",
                std::env::temp_dir().display()
            ))
        })?;
        Ok(place)
    }

    pub(super) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_dir_all(&self.0) {
            tracing::warn!(directory = %self.0.display(), %error, "cannot remove a temporary copy");
        }
    }
}

/// A directory that nobody else has made.
fn made() -> io::Result<PathBuf> {
    let name = |number| std::env::temp_dir().join(format!("ledgerd-state-{}-{number}", process::id()));
    for number in 0..TRIES_MAX {
        let path = name(number);
        match DirBuilder::new().mode(MODE).create(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            made => return made.map(|()| path),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

fn copy(from: &Path, to: &Path) -> io::Result<()> {
    for entry in fs::read_dir(from)? {
        let (entry, kind) = entry.and_then(|entry| entry.file_type().map(|kind| (entry, kind)))?;
        let to = to.join(entry.file_name());
        if kind.is_dir() {
            DirBuilder::new().mode(MODE).create(&to)?;
            copy(&entry.path(), &to)?;
        } else if kind.is_file() {
            fs::copy(entry.path(), &to)?;
        }
    }
    Ok(())
}
