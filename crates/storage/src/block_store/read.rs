//! Reading entries back: from memory, or by walking along the records from the nearest mark.

use std::io::ErrorKind;
use std::ops::Range;
use std::sync::Arc;

use super::files::{Files, StoredSegment};
use super::recent::weight;
use super::state::State;
use super::{BlockStore, StoreError};
use crate::entry::Entry;
use crate::segment::{LogPosition, RECORD_HEADER_BYTES, Record, RecordHeader, Window, decode_record};

/// Where the entries of a range are, at one moment.
struct Plan {
    /// First the older ones, on disk,
    stretches: Vec<Stretch>,
    /// then the newer ones, which are in memory.
    memory: Vec<Entry>,
}

/// Entries that follow each other in one file.
struct Stretch {
    segment: Arc<StoredSegment>,
    /// Where the record of the first one starts.
    offset: u32,
    /// The index of the first one.
    first: u64,
    /// Those that are wanted.
    wanted: Range<u64>,
}

/// The records read so far.
struct Reading {
    entries: Vec<Entry>,
    bytes_left: usize,
    full: bool,
}

impl BlockStore {
    /// One entry, or none if the log does not have it.
    pub fn entry(&self, index: u64) -> Result<Option<Entry>, StoreError> {
        Ok(self.entries(index..index.saturating_add(1), 0)?.pop())
    }

    /// The entries of `range` that the log has, as many as fit into `bytes_max` bytes of memory (or, on a long way, a
    /// few less), but one at least. Indices below [`first_index`](Self::first_index) are skipped.
    pub fn entries(&self, range: Range<u64>, bytes_max: usize) -> Result<Vec<Entry>, StoreError> {
        let plan = self.state().plan(range.clone(), bytes_max);
        match plan.read(&self.files, bytes_max) {
            Err(StoreError::Io { source, .. })
                if source.kind() == ErrorKind::NotFound && range.start < self.first_index() =>
            {
                // Dropped since the plan was made.
                self.state().plan(range, bytes_max).read(&self.files, bytes_max)
            }
            result => result,
        }
    }
}

impl State {
    fn plan(&self, range: Range<u64>, bytes_max: usize) -> Plan {
        let start = range.start.max(self.index.base().index + 1);
        let end = range.end.min(self.index.last().saturating_add(1));
        let split = self.recent.first().unwrap_or(end).clamp(start, end.max(start));
        // The newest are asked for all the time, and no file is opened for them.
        let stretches = if start < split { self.stretches(start..split, bytes_max) } else { Vec::new() };
        let (mut memory, mut bytes) = (Vec::new(), 0_usize);
        for index in split..end {
            let Some(entry) = self.recent.get(index) else { break };
            bytes = bytes.saturating_add(weight(entry));
            if bytes > bytes_max && !memory.is_empty() {
                break;
            }
            memory.push(entry.clone());
        }
        Plan { stretches, memory }
    }

    /// Stretches for the entries of `wanted`, or for about `bytes_max` bytes of them.
    fn stretches(&self, wanted: Range<u64>, bytes_max: usize) -> Vec<Stretch> {
        let mut stretches: Vec<Stretch> = Vec::new();
        let mut bytes = 0_usize;
        for mark in self.index.marks(wanted.start) {
            if mark.index >= wanted.end {
                break;
            }
            let LogPosition { sequence, offset } = mark.position;
            if let Some(before) = stretches.last_mut() {
                before.wanted.end = mark.index;
                // Across files the distance is not known, but there is at least an entry in between.
                let same = before.segment.sequence == sequence && before.first >= wanted.start;
                bytes += if same { offset.saturating_sub(before.offset) as usize } else { 1 };
            }
            let Some(segment) = self.segment(sequence).filter(|_| bytes <= bytes_max) else { break };
            let start = wanted.start.max(mark.index);
            let segment = Arc::clone(segment);
            stretches.push(Stretch { segment, offset, first: mark.index, wanted: start..wanted.end });
        }
        stretches
    }
}

impl Plan {
    fn read(self, files: &Files, bytes_max: usize) -> Result<Vec<Entry>, StoreError> {
        let mut reading = Reading { entries: Vec::new(), bytes_left: bytes_max, full: false };
        for stretch in self.stretches {
            stretch.read(files, &mut reading)?;
        }
        for entry in self.memory {
            reading.add(entry);
        }
        Ok(reading.entries)
    }
}

impl Stretch {
    /// Reads the wanted entries and checks them again: a disk may forget between two reads.
    fn read(self, files: &Files, reading: &mut Reading) -> Result<(), StoreError> {
        if reading.full {
            return Ok(());
        }
        let name = &self.segment.name;
        let io = |error| StoreError::io("read", name, error);
        let file = files.open(&self.segment).map_err(|error| StoreError::io("open", name, error))?;
        let mut window = Window::new(file).map_err(io)?;
        let (mut offset, mut index) = (u64::from(self.offset), self.first);
        while index < self.wanted.end && !reading.full {
            let corrupt = |what: &str| StoreError::corrupt(name, offset, what, index);
            let narrow = u32::try_from(offset).map_err(|_| corrupt("the file ends before this entry"))?;
            let position = LogPosition { sequence: self.segment.sequence, offset: narrow };
            let header = window.get(offset, RECORD_HEADER_BYTES).map_err(io)?;
            let header = RecordHeader::decode(header, self.segment.salt, position).map_err(corrupt)?;
            if header.is_entry() {
                if self.wanted.contains(&index) {
                    let at = offset + RECORD_HEADER_BYTES as u64;
                    let payload = window.get(at, header.length as usize).map_err(io)?;
                    match decode_record(&header, payload).map_err(corrupt)? {
                        Record::Entry(entry) if entry.index == index => reading.add(entry),
                        _ => return Err(corrupt("another record is stored here than was written")),
                    }
                }
                index += 1;
            }
            offset += header.record_bytes() as u64;
        }
        Ok(())
    }
}

impl Reading {
    fn add(&mut self, entry: Entry) {
        let bytes = weight(&entry);
        // A gap: the way to what is in memory is longer than was planned.
        let follows = self.entries.last().is_none_or(|last| last.index + 1 == entry.index);
        self.full |= !follows || bytes > self.bytes_left && !self.entries.is_empty();
        if !self.full {
            self.bytes_left = self.bytes_left.saturating_sub(bytes);
            self.entries.push(entry);
        }
    }
}
