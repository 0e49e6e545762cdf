//! One directory of files behind a trait, so that a simulator can tear, lose, fail and flip what a real disk may.
//!
//! The block store does all its input and output through [`Disk`] and [`DiskFile`]. Calls block; the caller provides
//! the threads. Errors are plain [`io::Error`]s; a full disk stays recognisable as [`io::ErrorKind::StorageFull`].

mod real;
#[cfg(any(test, feature = "sim"))]
mod sim;

use std::io;
use std::sync::Arc;

pub use real::{LOCK_FILE, RealDisk, open_to_read};
#[cfg(any(test, feature = "sim"))]
pub use sim::{Fault, SimDisk};

/// One directory, without sub-directories. Names are plain file names.
pub trait Disk: Send + Sync {
    /// Opens an existing file. Fails with [`io::ErrorKind::NotFound`] when there is none.
    fn open(&self, name: &str) -> io::Result<Arc<dyn DiskFile>>;

    /// Creates an empty file; one of the same name is emptied. The name is durable only after [`Disk::sync_dir`].
    fn create(&self, name: &str) -> io::Result<Arc<dyn DiskFile>>;

    /// The names of all files, sorted, without the lock file.
    fn list(&self) -> io::Result<Vec<String>>;

    /// Renames a file, replacing one that has the new name. Durable only after [`Disk::sync_dir`].
    fn rename(&self, from: &str, to: &str) -> io::Result<()>;

    /// Removes a file. Durable only after [`Disk::sync_dir`].
    fn remove(&self, name: &str) -> io::Result<()>;

    /// Makes every creation, renaming and removal so far durable (`fsync` of the directory).
    fn sync_dir(&self) -> io::Result<()>;
}

/// One open file. All methods take `&self`: positions are arguments, so readers and a writer share a handle.
#[expect(clippy::len_without_is_empty, reason = "the length of a file may fail; nobody asks whether it is empty")]
pub trait DiskFile: Send + Sync {
    /// Reads from `offset` on and returns how many bytes were read: less than `buf.len()` only at the end of the file.
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize>;

    /// Writes all of `buf` at `offset`, growing the file if needed. After an error any part of it may have been written.
    fn write_at(&self, buf: &[u8], offset: u64) -> io::Result<()>;

    /// Makes what was written durable (`fdatasync`). After an error nothing is known about any unsynced byte, and a
    /// second call proves nothing: the kernel may have dropped them. So never retry it.
    fn sync_data(&self) -> io::Result<()>;

    /// The length of the file in bytes.
    fn len(&self) -> io::Result<u64>;

    /// Cuts or grows (with zeros) the file to `bytes`.
    fn set_len(&self, bytes: u64) -> io::Result<()>;
}
