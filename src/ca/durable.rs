//! Files that survive a crash whole: a reader finds the old content or the new, never a part.

use ledger_rejection::{Code, Rejection};
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// Mode of files that hold a secret.
pub(crate) const SECRET_MODE: u32 = 0o600;
/// Mode of files that everybody may read.
pub(crate) const PUBLIC_MODE: u32 = 0o644;

/// New content of a file, on the disk beside the old one.
#[must_use = "nothing has changed until it is published"]
pub(crate) struct Staged {
    from: PathBuf,
    to: PathBuf,
}

/// Writes the new content of a file beside it, down to the disk. If that fails, nothing has changed.
pub(crate) fn stage(path: &Path, content: &[u8], mode: u32) -> Result<Staged, Rejection> {
    let mut from = path.as_os_str().to_owned();
    from.push(".new");
    let from = PathBuf::from(from);
    // What a crash left behind may have another mode.
    match fs::remove_file(&from) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(failed("remove", &from, &error)),
        _ => {}
    }
    create(&from, content, mode).inspect_err(|_| {
        let _ = fs::remove_file(&from);
    })?;
    Ok(Staged { from, to: path.to_owned() })
}

impl Staged {
    /// Puts the new content in the place of the old. If that fails, nobody knows which of the two a crash leaves.
    pub(crate) fn publish(self) -> Result<(), Rejection> {
        fs::rename(&self.from, &self.to).map_err(|error| failed("replace", &self.to, &error))?;
        self.to.parent().map_or(Ok(()), sync_directory)
    }
}

/// Writes a file that must not exist yet, down to the disk; its directory is left to [`sync_directory`].
pub(crate) fn create(path: &Path, content: &[u8], mode: u32) -> Result<(), Rejection> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true).mode(mode);
    let written = options.open(path).and_then(|mut file| {
        file.write_all(content)?;
        file.sync_all()
    });
    written.map_err(|error| failed("write", path, &error))
}

/// Reads a file of at most that many bytes.
pub(crate) fn read(path: &Path, bytes_max: usize) -> Result<Vec<u8>, Rejection> {
    let read = |error: io::Error| failed("read", path, &error);
    let file = File::open(path).map_err(read)?;
    let mut content = Vec::new();
    let limit = u64::try_from(bytes_max).unwrap_or(u64::MAX).saturating_add(1);
    file.take(limit).read_to_end(&mut content).map_err(read)?;
    if content.len() > bytes_max {
        return Err(Rejection::new(Code::BadFile, format!("{} is too large", path.display()))
            .wanted(format!("at most {bytes_max} bytes")));
    }
    Ok(content)
}

/// Makes a directory, and those above it, that only their owner may enter.
pub(crate) fn create_directory(path: &Path) -> Result<(), Rejection> {
    DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(|error| failed("make directory", path, &error))
}

/// Makes sure that a crash does not undo what was made, renamed or removed in a directory.
pub(crate) fn sync_directory(path: &Path) -> Result<(), Rejection> {
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    File::open(path).and_then(|directory| directory.sync_all()).map_err(|error| failed("sync", path, &error))
}

/// A failed operation on a file, for people.
pub(crate) fn failed(what: &str, path: &Path, error: &io::Error) -> Rejection {
    let (code, next) = match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => (Code::DiskFull, "free space on this disk"),
        io::ErrorKind::NotFound => (Code::BadFile, "check the path"),
        io::ErrorKind::PermissionDenied => (Code::BadFile, "check who owns it and its mode"),
        io::ErrorKind::AlreadyExists => (Code::BadFile, "choose another path, or move it away"),
        _ => (Code::DiskFailed, "look at the disk and at the system's log"),
    };
    Rejection::new(code, format!("cannot {what} {}", path.display())).found(error.to_string()).next(next)
}
