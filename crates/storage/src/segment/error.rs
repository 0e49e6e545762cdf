//! The faults of the store.

use ledger_base::rejection::{Code, Rejection};
use std::io::{self, ErrorKind};
use std::sync::Arc;

/// Advice to an operator about damage. A voter must not go on under its number with less than it has promised.
const COME_BACK: &str = "keep a copy of the directory; then, if other nodes have the blocks, ledgerd rejoin --config FILE, \
                         else restore the directory from a copy";

/// An error of the block store.
#[derive(Debug, Clone, thiserror::Error)]
pub enum StoreError {
    /// The operating system refused. During a write this poisons the store: restart, and recovery decides.
    #[error("cannot {operation} {file}: {source}; check the disk, then restart the node")]
    Io {
        /// The failed operation.
        operation: &'static str,
        /// Name of the file, inside of the store's directory.
        file: String,
        /// The error of the system.
        source: Arc<io::Error>,
    },
    /// No space is left. Staged entries stay staged and nothing of them is on disk: make room and flush again.
    #[error(
        "the disk is full: cannot {operation} {file} ({wanted_bytes} bytes wanted); free disk space, then try \
             again"
    )]
    DiskFull {
        /// The failed operation.
        operation: &'static str,
        /// Name of the file.
        file: String,
        /// Bytes that did not fit.
        wanted_bytes: u64,
    },
    /// The disk does not hold what was written to it, and what is damaged had been durable.
    #[error("{file} is damaged at byte {offset} (entry {index} or later): {what}")]
    Corrupt {
        /// Name of the file.
        file: String,
        /// First byte of what is wrong.
        offset: u64,
        /// The fault.
        what: String,
        /// First index that cannot be trusted.
        index: u64,
    },
    /// The directory belongs to another network.
    #[error(
        "{file} belongs to network {}, wanted {}; use the node's own directory",
        hex::encode(found),
        hex::encode(wanted)
    )]
    WrongNetwork {
        /// Name of the file.
        file: String,
        /// Hash in the file.
        found: [u8; 32],
        /// Hash the caller gave.
        wanted: [u8; 32],
    },
    /// Entries to append do not continue the log. Nothing was staged.
    #[error("entry {found} cannot be appended: the log continues with {wanted}, or with an earlier index that it has")]
    Gap {
        /// Index found.
        found: u64,
        /// Index that would continue the log.
        wanted: u64,
    },
    /// The log cannot begin after this snapshot: it holds the block itself, or later ones that were promised. Nothing
    /// was changed.
    #[error(
        "the log cannot start after block {index} of term {term}: it contains {first} to {last}, {committed} of it \
         committed; drop the blocks older than the snapshot instead"
    )]
    NotBehind {
        /// Height of the snapshot.
        index: u64,
        /// Term of its block.
        term: u64,
        /// First index of the log.
        first: u64,
        /// Last index of the log.
        last: u64,
        /// Newest index known to be committed.
        committed: u64,
    },
    /// An entry is larger than a record may be. Nothing was staged.
    #[error("entry {index} has {found_bytes} bytes of data, the limit is {max_bytes}; send less in one block")]
    TooLarge {
        /// Index of the entry.
        index: u64,
        /// Its size.
        found_bytes: usize,
        /// The limit.
        max_bytes: usize,
    },
    /// Too much waits for the disk. Nothing was staged.
    #[error("{staged_bytes} bytes wait for the disk, the limit is {max_bytes}; flush before appending more")]
    StageFull {
        /// Bytes staged, with what was to be added.
        staged_bytes: usize,
        /// The limit.
        max_bytes: usize,
    },
    /// The orderer broke a rule of the log. This poisons the store.
    #[error("{0}; this is a bug: restart the node and report it")]
    Violation(String),
    /// An option makes no sense.
    #[error("{0}")]
    Options(String),
}

impl StoreError {
    /// An error of the disk while doing `operation` with `file`.
    pub(crate) fn io(operation: &'static str, file: &str, source: io::Error) -> Self {
        Self::Io { operation, file: file.to_owned(), source: Arc::new(source) }
    }

    /// An error of the disk while writing: a full disk is told apart.
    pub(crate) fn writing(operation: &'static str, file: &str, wanted_bytes: u64, source: io::Error) -> Self {
        if source.kind() == ErrorKind::StorageFull {
            return Self::DiskFull { operation, file: file.to_owned(), wanted_bytes };
        }
        Self::io(operation, file, source)
    }

    pub(crate) fn corrupt(file: &str, offset: u64, what: impl Into<String>, index: u64) -> Self {
        Self::Corrupt { file: file.to_owned(), offset, what: what.into(), index }
    }
}

impl From<StoreError> for Rejection {
    fn from(error: StoreError) -> Self {
        let code = match &error {
            StoreError::DiskFull { .. } => Code::DiskFull,
            StoreError::Io { .. } => Code::DiskFailed,
            StoreError::Corrupt { .. } | StoreError::WrongNetwork { .. } => Code::Corrupt,
            StoreError::TooLarge { .. } => Code::TooLarge,
            StoreError::StageFull { .. } => Code::Overloaded,
            StoreError::Gap { .. }
            | StoreError::NotBehind { .. }
            | StoreError::Violation(_)
            | StoreError::Options(_) => Code::Internal,
        };
        let rejection = Self::new(code, error.to_string());
        match error {
            StoreError::Corrupt { .. } => rejection.wanted("the bytes that were written").next(COME_BACK),
            _ => rejection,
        }
    }
}
