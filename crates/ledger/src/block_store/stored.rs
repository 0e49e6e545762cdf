//! Reading one durable entry back.

use std::sync::Arc;

use super::StoreError;
use super::index::Location;
use crate::disk::DiskFile;
use crate::entry::Entry;
use crate::segment::{LogPosition, RECORD_HEADER_BYTES, Record, RecordHeader, decode_record};

/// A segment with its open file.
pub(super) struct StoredSegment {
    pub(super) name: String,
    pub(super) sequence: u32,
    /// Seeds the CRCs of its records.
    pub(super) salt: u64,
    pub(super) file: Arc<dyn DiskFile>,
}

impl StoredSegment {
    /// Reads the entry `index` at `location` and checks it again: a disk may forget between two reads.
    pub(super) fn read(&self, index: u64, location: Location) -> Result<Entry, StoreError> {
        let offset = u64::from(location.offset);
        let mut bytes = vec![0; location.bytes as usize];
        let count = self.file.read_at(&mut bytes, offset).map_err(|error| StoreError::io("read", &self.name, error))?;
        let corrupt = |what: &str| StoreError::corrupt(&self.name, offset, what, index);
        if count < bytes.len() {
            return Err(corrupt("the file ends inside of a record"));
        }
        let position = LogPosition { sequence: self.sequence, offset: location.offset };
        let header = RecordHeader::decode(&bytes, self.salt, position).map_err(corrupt)?;
        let payload = bytes.get(RECORD_HEADER_BYTES..).unwrap_or_default();
        match decode_record(&header, payload).map_err(corrupt)? {
            Record::Entry(entry) if entry.index == index => Ok(entry),
            _ => Err(corrupt("another record is here than was written")),
        }
    }
}
