//! Files that survive a crash whole: a reader finds the old content or the new, never a part.
//!
//! New content is written beside the old one and synced, then it takes the old one's name, then the directory is synced.
//! Each error names the file. The log of blocks has a disk of its own: `ledger-storage`.
//!
//! ```
//! let place = tempfile::tempdir().unwrap();
//! let path = place.path().join("node.json");
//! ledger_base::durable::replace(&path, b"{}", ledger_base::durable::SECRET_MODE).unwrap();
//! assert_eq!(ledger_base::durable::read(&path, 100).unwrap(), b"{}");
//! ```

mod access;
mod directory;
mod file;
mod medium;

pub use access::access;
pub use directory::{create_directory, rename, sync_directory};
pub use file::{Staged, create, read, replace, stage, stage_from};

use crate::rejection::{Code, Rejection};
use std::io;
use std::path::Path;

/// Mode of files that hold a secret.
pub const SECRET_MODE: u32 = 0o600;
/// Mode of files that everybody may read.
pub const PUBLIC_MODE: u32 = 0o644;

/// A failed operation on a file, for people.
pub fn failed(what: &str, path: &Path, error: &io::Error) -> Rejection {
    let (code, next) = match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => (Code::DiskFull, ""),
        io::ErrorKind::NotFound | io::ErrorKind::IsADirectory | io::ErrorKind::NotADirectory => {
            (Code::BadFile, "check the path")
        }
        io::ErrorKind::PermissionDenied => (Code::BadFile, "check who owns it and its mode"),
        io::ErrorKind::AlreadyExists => (Code::BadFile, "choose another path, or move it away"),
        _ => (Code::DiskFailed, ""),
    };
    let found = match error.kind() {
        io::ErrorKind::PermissionDenied => format!("{error}; {}", access(path)),
        _ => error.to_string(),
    };
    Rejection::new(code, format!("cannot {what} {}", path.display())).found(found).next(next)
}
