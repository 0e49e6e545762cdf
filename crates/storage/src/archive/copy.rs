//! Copying one segment: it is checked record by record in its new place before it gets its name there.

use super::fault::{full_or_failed, in_archive, in_node};
use crate::block_store::StoreError;
use crate::disk::Disk;
use crate::segment::{Found, Scan, ScannedSegment, check_sealed};
use ledger_base::rejection::Rejection;
use std::io::{self, ErrorKind};

/// How much is copied at once.
const PIECE_BYTES: u64 = 1 << 20;

/// The part of a segment that the archive shall hold.
pub(super) struct Wanted<'a> {
    pub(super) segment: &'a ScannedSegment,
    /// Its bytes up to here.
    pub(super) end: u64,
    /// The bytes behind them in the archive: of an unfinished segment the hard state that commits them.
    pub(super) record: Vec<u8>,
    /// The segment after it, if it is finished.
    pub(super) next: Option<&'a ScannedSegment>,
    /// Height of the block after its last.
    pub(super) next_height: u64,
}

impl<'a> Wanted<'a> {
    /// All of it, without the zeros behind.
    pub(super) fn finished(segment: &'a ScannedSegment, next: &'a ScannedSegment) -> Self {
        let (end, next_height) = (next.header.durable_upto.offset.into(), next.header.first_index);
        Self { segment, end, record: Vec::new(), next: Some(next), next_height }
    }

    /// Bytes of the file in the archive.
    pub(super) fn bytes(&self) -> u64 {
        self.end + self.record.len() as u64
    }

    /// Reads every record of the copy in file `name`.
    fn check(&self, target: &dyn Disk, name: &str) -> Result<(), StoreError> {
        if let Some(next) = self.next {
            return check_sealed(target, name, self.segment, next);
        }
        let mut scan = Scan::unfinished(target, name, self.segment);
        scan.by_ref().try_for_each(|found| whole(found?))?;
        if scan.tail().end == self.bytes() {
            return Ok(());
        }
        Err(StoreError::corrupt(name, scan.tail().end, "the copy ends here", self.next_height))
    }
}

/// Refuses a segment that does not end with a record.
pub(super) fn whole(found: Found) -> Result<(), StoreError> {
    match found {
        Found::Record { .. } => Ok(()),
        Found::Torn { file, offset, what, .. } => Err(StoreError::corrupt(&file, offset, what, 0)),
    }
}

/// Copies one segment, in place of what the archive has of it; none if the node has dropped it.
pub(super) fn copy(source: &dyn Disk, target: &dyn Disk, wanted: &Wanted<'_>) -> Result<Option<u64>, Rejection> {
    let Wanted { segment, end, record, .. } = wanted;
    let part = format!("{}.part", segment.name);
    let file = match source.open(&segment.name) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        file => file.map_err(|error| in_node(&StoreError::io("open", &segment.name, error)))?,
    };
    let write = || -> io::Result<()> {
        let copy = target.create(&part)?;
        let mut at = 0;
        while at < *end {
            let mut piece = vec![0; usize::try_from(PIECE_BYTES.min(end - at)).unwrap_or(0)];
            let count = file.read_at(&mut piece, at)?;
            piece.truncate(count);
            copy.write_at(&piece, at)?;
            if count == 0 {
                break;
            }
            at += count as u64;
        }
        if !record.is_empty() {
            copy.write_at(record, at)?;
        }
        copy.sync_data()
    };
    let written = write().map_err(|error| full_or_failed("copy", &segment.name, wanted.bytes(), error));
    let checked = written.and_then(|()| {
        wanted.check(target, &part).map_err(|error| match error {
            StoreError::Corrupt { offset, what, index, .. } => StoreError::corrupt(&segment.name, offset, what, index),
            other => other,
        })
    });
    if let Err(error) = checked {
        let _ = target.remove(&part);
        return Err(in_node(&error));
    }
    let named = target.rename(&part, &segment.name).and_then(|()| target.sync_dir());
    named.map_err(|error| in_archive(&StoreError::io("rename", &part, error)))?;
    Ok(Some(wanted.bytes()))
}
