//! The demands of the world state on the place where it is kept between runs.

use crate::state::WriteSet;
use bytes::Bytes;
use ledger_base::rejection::Rejection;

/// A sorted store with atomic batches.
pub trait Store: Send + Sync {
    /// The value of a key.
    ///
    /// # Errors
    /// [`Code::DiskFailed`], [`Code::Corrupt`].
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection>;

    /// At most `limit` pairs in order whose keys start with `prefix` and, if given, are greater than `after`.
    ///
    /// # Errors
    /// As [`Store::get`].
    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection>;

    /// Writes everything or nothing, and waits for the disk.
    ///
    /// # Errors
    /// [`Code::DiskFull`], [`Code::DiskFailed`].
    fn write(&self, batch: &WriteSet, tip: (&[u8], &[u8])) -> Result<(), Rejection>;
}
