//! Faults of the two directories, told apart.

use crate::block_store::StoreError;
use ledger_base::rejection::Rejection;
use std::io::{self, ErrorKind};

/// Was the file dropped meanwhile?
pub(super) fn is_gone(error: &StoreError) -> bool {
    matches!(error, StoreError::Io { source, .. } if source.kind() == ErrorKind::NotFound)
}

pub(super) fn full_or_failed(operation: &'static str, file: &str, wanted_bytes: u64, error: io::Error) -> StoreError {
    match error.kind() {
        ErrorKind::StorageFull => StoreError::DiskFull { operation, file: file.to_owned(), wanted_bytes },
        _ => StoreError::io(operation, file, error),
    }
}

pub(super) fn in_node(error: &StoreError) -> Rejection {
    named("the node's block store", error)
}

pub(super) fn in_archive(error: &StoreError) -> Rejection {
    named("the archive", error)
}

fn named(place: &str, error: &StoreError) -> Rejection {
    Rejection::from(error.clone()).prefix(format_args!("{place}: "))
}
