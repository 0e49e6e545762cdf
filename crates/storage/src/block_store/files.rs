//! The segments of a store and their open files, of which there are never more than a bounded number.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex};

use super::lock::lock;
use crate::disk::{Disk, DiskFile};

/// How many segments are kept open for reading.
const OPEN_MAX: usize = 64;

/// A segment, and what is needed to read it.
#[derive(Debug)]
pub(super) struct StoredSegment {
    pub(super) name: String,
    pub(super) sequence: u32,
    /// Of its header.
    pub(super) crc: u32,
    /// Seeds the CRCs of its records.
    pub(super) salt: u64,
    /// The index that follows the newest entry before it.
    pub(super) first_index: u64,
    /// Bytes of the segment before it; 0 if it begins the log.
    pub(super) bytes_before: u32,
}

/// Opens segments on demand and keeps those open that were used last.
pub(super) struct Files {
    disk: Arc<dyn Disk>,
    open: Mutex<Open>,
}

#[derive(Default)]
struct Open {
    /// The one used last is at the back.
    files: VecDeque<(u32, Arc<dyn DiskFile>)>,
    /// Segments before this one are dropped: kept open, they would keep their place on the disk.
    oldest: u32,
}

impl Files {
    pub(super) fn new(disk: Arc<dyn Disk>) -> Self {
        Self { disk, open: Mutex::default() }
    }

    pub(super) fn open(&self, segment: &StoredSegment) -> io::Result<Arc<dyn DiskFile>> {
        if let Some(file) = self.take(segment.sequence) {
            self.put(segment.sequence, &file);
            return Ok(file);
        }
        let file = self.disk.open(&segment.name)?;
        self.put(segment.sequence, &file);
        Ok(file)
    }

    /// Closes the segments before `oldest`, once their readers are done.
    pub(super) fn close_before(&self, oldest: u32) {
        let mut open = lock(&self.open);
        open.oldest = oldest;
        open.files.retain(|(sequence, _)| *sequence >= oldest);
    }

    fn take(&self, sequence: u32) -> Option<Arc<dyn DiskFile>> {
        let files = &mut lock(&self.open).files;
        let place = files.iter().rposition(|(number, _)| *number == sequence)?;
        files.remove(place).map(|(_, file)| file)
    }

    fn put(&self, sequence: u32, file: &Arc<dyn DiskFile>) {
        let mut open = lock(&self.open);
        if sequence < open.oldest {
            return;
        }
        open.files.push_back((sequence, Arc::clone(file)));
        if open.files.len() > OPEN_MAX {
            open.files.pop_front();
        }
    }
}
