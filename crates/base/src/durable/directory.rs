//! Directories: made, renamed, synced.

use super::failed;
use super::medium::{Medium, Real};
use crate::rejection::Rejection;
use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;

/// Makes a directory, and those above it, that only their owner may enter.
///
/// # Errors
/// The directory, and what the system says.
pub fn create_directory(path: &Path) -> Result<(), Rejection> {
    DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(|error| failed("make directory", path, &error))
}

/// Gives a file or directory another name, for good: the directories of both names are synced.
///
/// # Errors
/// The name that failed, and what the system says.
pub fn rename(from: &Path, to: &Path) -> Result<(), Rejection> {
    rename_on(&Real, from, to)
}

pub(crate) fn rename_on(medium: &impl Medium, from: &Path, to: &Path) -> Result<(), Rejection> {
    medium
        .rename(from, to)
        .map_err(|error| failed("move", from, &error).wanted(format!("to name it {}", to.display())))?;
    // First the new name: a crash in between leaves both, never none.
    sync_on(medium, parent(to))?;
    if from.parent() == to.parent() { Ok(()) } else { sync_on(medium, parent(from)) }
}

/// Makes sure that a crash does not undo what was made, renamed or removed in a directory.
///
/// # Errors
/// The directory, and what the system says.
pub fn sync_directory(path: &Path) -> Result<(), Rejection> {
    sync_on(&Real, path)
}

fn sync_on(medium: &impl Medium, path: &Path) -> Result<(), Rejection> {
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    medium.sync_directory(path).map_err(|error| failed("sync", path, &error))
}

fn parent(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new("."))
}
