//! The segments of a store and their open files, of which there are never more than a bounded number.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex};

use super::writer::lock;
use crate::disk::{Disk, DiskFile};

/// How many segments are kept open for reading.
const OPEN_MAX: usize = 64;

/// A segment, and what is needed to read it.
#[derive(Debug)]
pub(super) struct StoredSegment {
    pub(super) name: String,
    pub(super) sequence: u32,
    /// Seeds the CRCs of its records.
    pub(super) salt: u64,
    /// The index that follows the newest entry before it.
    pub(super) first_index: u64,
}

/// Opens segments on demand and keeps those open that were used last.
pub(super) struct Files {
    disk: Arc<dyn Disk>,
    /// The one used last is at the back.
    open: Mutex<VecDeque<(u32, Arc<dyn DiskFile>)>>,
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

    /// Closes a segment, once its readers are done.
    pub(super) fn close(&self, sequence: u32) {
        self.take(sequence);
    }

    fn take(&self, sequence: u32) -> Option<Arc<dyn DiskFile>> {
        let mut open = lock(&self.open);
        let place = open.iter().rposition(|(number, _)| *number == sequence)?;
        open.remove(place).map(|(_, file)| file)
    }

    fn put(&self, sequence: u32, file: &Arc<dyn DiskFile>) {
        let mut open = lock(&self.open);
        open.push_back((sequence, Arc::clone(file)));
        if open.len() > OPEN_MAX {
            open.pop_front();
        }
    }
}
