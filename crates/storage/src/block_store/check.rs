//! Looking for rot in what is finished, as opening a store does not read that.

use std::io::ErrorKind;
use std::ops::ControlFlow;
use std::sync::Arc;

use super::files::StoredSegment;
use super::{BlockStore, StoreError};
use crate::segment::{Found, Scan, ScannedSegment, read_header};

impl BlockStore {
    /// Reads every record of the finished segments, the oldest first, and checks all that verification checks without
    /// executing. Goes on beside everything else; blocks that are dropped meanwhile are left out.
    ///
    /// `go_on` is called with the bytes of each record, so that the caller can take its time; false ends the check.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] with file and offset of the first damage; [`StoreError::Io`] if a file cannot be read.
    pub fn check_finished(&self, mut go_on: impl FnMut(u32) -> bool) -> Result<(), StoreError> {
        let mut from = 0;
        loop {
            let segments: Vec<Arc<StoredSegment>> =
                self.state().segments.iter().filter(|segment| segment.sequence >= from).cloned().collect();
            let oldest = segments.first().map_or(0, |segment| segment.sequence);
            match self.check(&segments, &mut go_on) {
                Err(StoreError::Io { source, .. })
                    if source.kind() == ErrorKind::NotFound && self.oldest_sequence() > oldest =>
                {
                    from = self.oldest_sequence();
                }
                result => return result,
            }
        }
    }

    fn check(&self, segments: &[Arc<StoredSegment>], go_on: &mut impl FnMut(u32) -> bool) -> Result<(), StoreError> {
        let disk = self.disk.as_ref();
        let scanned = segments.iter().map(|segment| {
            let (header, crc) = read_header(disk, &segment.name, segment.first_index)?;
            Ok(ScannedSegment { name: segment.name.as_str().into(), header, crc })
        });
        let scanned: Vec<ScannedSegment> = scanned.collect::<Result<_, StoreError>>()?;
        let checked = Scan::finished(disk, scanned).try_for_each(|found| match found {
            Ok(Found::Record { bytes, .. }) if !go_on(bytes) => ControlFlow::Break(Ok(())),
            Ok(_) => ControlFlow::Continue(()),
            Err(error) => ControlFlow::Break(Err(error)),
        });
        match checked {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(result) => result,
        }
    }

    fn oldest_sequence(&self) -> u32 {
        self.state().segments.front().map_or(0, |oldest| oldest.sequence)
    }
}
