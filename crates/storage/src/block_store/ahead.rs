//! Writing zeros ahead of the log, so that a commit writes into blocks the file system has already placed.
//!
//! A commit that only overwrites needs no change of the file's metadata under its `fdatasync`. The whole next segment
//! is zeroed before it is needed, as zeroing the active file makes the commits beside it slower.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::StoreError;
use crate::disk::{Disk, DiskFile};

/// How far the active segment is zeroed ahead of the log.
pub(super) const AHEAD_BYTES: u64 = 4 << 20;

/// How much is zeroed and synced at once; a commit may have to wait for that.
pub(super) const CHUNK_BYTES: u64 = 1 << 20;

/// Where the log ends in the active segment and how far that is zeroed: read by the flusher without a lock.
#[derive(Debug, Default)]
pub(super) struct Marks {
    /// End of the records, written or about to be.
    pub(super) position: AtomicU64,
    /// From `position` up to here the file holds zeros. Never below `position` except while a write beyond is going on,
    /// which holds the lock of [`Ahead`].
    pub(super) zeroed: AtomicU64,
}

impl Marks {
    /// Less than half of what is wanted is zeroed.
    pub(super) fn are_low(&self, segment_bytes: u64) -> bool {
        let half = self.position.load(Ordering::Acquire).saturating_add(AHEAD_BYTES / 2);
        self.zeroed.load(Ordering::Acquire) < half.min(segment_bytes)
    }
}

/// The files that are zeroed ahead. A change of `Marks::zeroed` needs the lock around this.
#[derive(Default)]
pub(super) struct Ahead {
    /// The active segment.
    pub(super) active: Option<(String, Arc<dyn DiskFile>)>,
    /// The segment to come.
    pub(super) spare: Option<Spare>,
    /// Sequence number of the newest segment.
    pub(super) newest: u32,
    /// A flush is making the next segment: its file must not be made a second time.
    pub(super) beginning: bool,
}

/// A file that waits to become a segment.
pub(super) struct Spare {
    /// Its name until then.
    pub(super) name: String,
    pub(super) file: Arc<dyn DiskFile>,
    /// The file holds zeros up to here.
    pub(super) zeroed: u64,
}

/// Name of the file that becomes segment `sequence`.
pub(super) fn spare_name(sequence: u32) -> String {
    format!("{sequence:010}.new")
}

impl Spare {
    pub(super) fn create(disk: &dyn Disk, sequence: u32) -> Result<Self, StoreError> {
        let name = spare_name(sequence);
        let file = disk.create(&name).map_err(|error| StoreError::writing("create", &name, 0, error))?;
        Ok(Self { name, file, zeroed: 0 })
    }
}

impl Ahead {
    /// Zeroes and syncs one chunk, where it is most needed. False if nothing is to do.
    pub(super) fn prepare(&mut self, disk: &dyn Disk, marks: &Marks, segment_bytes: u64) -> Result<bool, StoreError> {
        let position = marks.position.load(Ordering::Acquire);
        if let Some((name, file)) = &self.active {
            let zeroed = marks.zeroed.load(Ordering::Acquire);
            if zeroed < segment_bytes.min(position.saturating_add(AHEAD_BYTES)) {
                let end = zero_chunk(file.as_ref(), name, zeroed, segment_bytes)?;
                marks.zeroed.store(end, Ordering::Release);
                return Ok(true);
            }
        }
        // A young store stays small: the next segment is begun when this one is half full.
        let wanted = match &self.active {
            None => AHEAD_BYTES.min(segment_bytes),
            Some(_) if position > segment_bytes / 2 => segment_bytes,
            Some(_) => return Ok(false),
        };
        if self.beginning {
            return Ok(false);
        }
        let spare = match &mut self.spare {
            Some(spare) => spare,
            none => none.insert(Spare::create(disk, self.newest + 1)?),
        };
        if spare.zeroed >= wanted {
            return Ok(false);
        }
        spare.zeroed = zero_chunk(spare.file.as_ref(), &spare.name, spare.zeroed, wanted)?;
        Ok(true)
    }
}

/// Zeroes from `start` to the end of its chunk, or to `limit`; returns where it stopped.
fn zero_chunk(file: &dyn DiskFile, name: &str, start: u64, limit: u64) -> Result<u64, StoreError> {
    let end = limit.min((start / CHUNK_BYTES + 1) * CHUNK_BYTES);
    write_zeros(file, name, start, end)?;
    file.sync_data().map_err(|error| StoreError::io("sync", name, error))?;
    Ok(end)
}

/// Writes zeros to `start..end`.
pub(super) fn write_zeros(file: &dyn DiskFile, name: &str, start: u64, end: u64) -> Result<(), StoreError> {
    let zeros = vec![0; usize::try_from(CHUNK_BYTES.min(end.saturating_sub(start))).unwrap_or(0)];
    let mut at = start;
    while at < end {
        let count = usize::try_from(end - at).unwrap_or(usize::MAX).min(zeros.len());
        let piece = zeros.get(..count).unwrap_or_default();
        file.write_at(piece, at).map_err(|error| StoreError::writing("zero", name, end - at, error))?;
        at += count as u64;
    }
    Ok(())
}
