//! Reading a whole store in order, trusting nothing: for recovery and for offline verification.

use std::sync::Arc;

use super::error::StoreError;
use super::header::{Base, HEADER_BYTES, LogPosition, SegmentHeader, parse_name};
use super::record::{RECORD_HEADER_BYTES, Record, RecordHeader, decode_record};
use super::seal::{Contents, Seal};
use super::window::Window;
use crate::disk::Disk;
use crate::entry::HardState;

/// A finding of a scan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// A good record.
    Record {
        /// Name of its file.
        file: Arc<str>,
        /// Where it starts.
        position: LogPosition,
        /// Bytes of its header and payload.
        bytes: u32,
        /// Up to where the log was durable when it was written.
        durable_upto: LogPosition,
        /// Its content.
        record: Record,
    },
    /// The rest of a write that was cut off and never acknowledged. Always the last item. Opening the store zeroes it.
    Torn {
        /// Name of the file.
        file: Arc<str>,
        /// First byte after the last good record.
        offset: u64,
        /// Bytes up to the last one that is not zero.
        bytes: u64,
        /// The fault of the record that should be there.
        what: &'static str,
    },
}

/// Iterator over the records of a store; ends after the first error.
pub struct Scan<'a> {
    disk: &'a dyn Disk,
    segments: Vec<ScannedSegment>,
    /// Segments that are void since the log was begun anew after a snapshot.
    void: Vec<String>,
    /// Files that are no segments.
    ignored: Vec<String>,
    /// Which segment is being read.
    at: usize,
    /// How many are to be read; the one after them is only compared with where they end.
    until: usize,
    /// Where its next record starts; 0 before the header was looked at.
    offset: u64,
    /// CRC the next record has to name.
    previous: u32,
    /// Up to where the newest segment is proven durable by its own records.
    proven: u64,
    /// The index after the newest entry seen.
    next_index: u64,
    /// Its term.
    last_term: u64,
    /// The content of the segment that is being read, as far as it is read.
    contents: Contents,
    /// The wanted content of its own seal, if the segment before it was read too.
    sealed: Option<Seal>,
    window: Option<Window>,
    done: bool,
}

/// A segment that a scan has seen the header of.
#[derive(Clone)]
pub(crate) struct ScannedSegment {
    pub(crate) name: Arc<str>,
    pub(crate) header: SegmentHeader,
    /// CRC of the header.
    pub(crate) crc: u32,
}

/// Where the log ends, once a scan is done.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tail {
    /// First byte after the last good record of the newest segment.
    pub(crate) end: u64,
    /// CRC the next record has to name.
    pub(crate) previous: u32,
    /// Up to where its own records prove the newest segment durable.
    pub(crate) proven: u64,
    /// Index and term of the newest entry written, superseded or not.
    pub(crate) newest: Base,
}

/// Checks the header of every segment of `disk`; the iterator then reads the records.
///
/// `network`: refuse segments of another one. Changes nothing, so it works on a disk that is open for reading only.
pub fn scan<'a>(disk: &'a dyn Disk, network: Option<&[u8; 32]>) -> Result<Scan<'a>, StoreError> {
    let names = disk.list().map_err(|error| StoreError::io("list", ".", error))?;
    let (mut segments, mut void, mut ignored) = (Vec::<ScannedSegment>::new(), Vec::new(), Vec::new());
    // From the newest to the one that begins the log. Names sort as their numbers do.
    for name in names.into_iter().rev() {
        let Some((sequence, first_index)) = parse_name(&name) else {
            ignored.push(name);
            continue;
        };
        let after = segments.last();
        if after.is_some_and(|after| after.header.begins_log()) {
            void.push(name);
            continue;
        }
        if let Some(after) = after.filter(|after| sequence.checked_add(1) != Some(after.header.sequence)) {
            let wanted = after.header.sequence.saturating_sub(1);
            let what = format!("this is segment {sequence}, but segment {wanted} is missing or duplicate");
            return Err(StoreError::corrupt(&name, 0, what, first_index));
        }
        let (header, crc) = read_header(disk, &name, first_index)?;
        if let Some(wanted) = network.filter(|wanted| **wanted != header.network) {
            return Err(StoreError::WrongNetwork { file: name, found: header.network, wanted: *wanted });
        }
        if (header.sequence, header.first_index) != (sequence, first_index) {
            let what =
                format!("the header says segment {}, first index {}: renamed?", header.sequence, header.first_index);
            return Err(StoreError::corrupt(&name, 12, what, first_index));
        }
        if !header.begins_log() && Some(header.durable_upto.sequence) != sequence.checked_sub(1) {
            return Err(StoreError::corrupt(&name, 64, "the header does not follow the segment before", first_index));
        }
        segments.push(ScannedSegment { name: name.into(), header, crc });
    }
    segments.reverse();
    void.reverse();
    ignored.reverse();
    let until = segments.len();
    Ok(Scan { void, ignored, ..Scan::over(disk, segments, until) })
}

/// The beginning of a segment, where that is in order.
#[derive(Debug, Default)]
pub(crate) struct Head {
    pub(crate) hard_state: Option<HardState>,
    /// About the segment before.
    pub(crate) seal: Option<Seal>,
}

/// Reads the hard state and the seal at the beginning of a segment. A wrong part is left out: reading the segments
/// whole then names the fault.
pub(crate) fn read_head(disk: &dyn Disk, segment: &ScannedSegment) -> Result<Head, StoreError> {
    let name = &segment.name;
    let file = disk.open(name).map_err(|error| StoreError::io("open", name, error))?;
    let mut window = Window::small(file).map_err(|error| StoreError::io("read", name, error))?;
    let (mut head, mut offset, mut previous) = (Head::default(), HEADER_BYTES, segment.crc);
    while head.seal.is_none() {
        let position = LogPosition { sequence: segment.header.sequence, offset: narrow(offset) };
        let decoded = decode_at(&mut window, segment, position, previous);
        match decoded.map_err(|error| StoreError::io("read", name, error))? {
            Ok((header, Record::HardState(hard_state))) if head.hard_state.is_none() => {
                head.hard_state = Some(hard_state);
                offset += header.record_bytes() as u64;
                previous = header.crc;
            }
            Ok((_, Record::Seal(seal))) => head.seal = Some(seal),
            _ => break,
        }
    }
    Ok(head)
}

/// Reads every record of the segment in file `name`, and checks that it ends where `next`, the one after it, says.
pub(crate) fn check_sealed(
    disk: &dyn Disk,
    name: &str,
    segment: &ScannedSegment,
    next: &ScannedSegment,
) -> Result<(), StoreError> {
    let segment = ScannedSegment { name: name.into(), ..segment.clone() };
    Scan::over(disk, vec![segment, next.clone()], 1).try_for_each(|found| found.map(drop))
}

/// Reads the header of a segment, and its CRC.
pub(crate) fn read_header(disk: &dyn Disk, name: &str, first_index: u64) -> Result<(SegmentHeader, u32), StoreError> {
    let file = disk.open(name).map_err(|error| StoreError::io("open", name, error))?;
    let mut bytes = [0; HEADER_BYTES as usize];
    let count = file.read_at(&mut bytes, 0).map_err(|error| StoreError::io("read", name, error))?;
    SegmentHeader::decode(bytes.get(..count).unwrap_or_default())
        .map_err(|(offset, what)| StoreError::corrupt(name, offset, what, first_index))
}

impl<'a> Scan<'a> {
    fn over(disk: &'a dyn Disk, segments: Vec<ScannedSegment>, until: usize) -> Self {
        let oldest = segments.first().map(|segment| segment.header);
        let base = oldest.as_ref().map_or_else(Base::default, SegmentHeader::base);
        Self {
            disk,
            segments,
            void: Vec::new(),
            ignored: Vec::new(),
            at: 0,
            until,
            offset: 0,
            previous: oldest.map_or(0, |header| header.previous),
            proven: 0,
            next_index: base.index + 1,
            last_term: base.term,
            contents: Contents::default(),
            sealed: None,
            window: None,
            done: false,
        }
    }

    /// Reads all of these segments but the last, which is only compared with where the one before it ends.
    pub(crate) fn finished(disk: &'a dyn Disk, segments: Vec<ScannedSegment>) -> Self {
        let until = segments.len().saturating_sub(1);
        Self::over(disk, segments, until)
    }

    /// Reads the segment in file `name`, alone, as the newest of its log.
    pub(crate) fn unfinished(disk: &'a dyn Disk, name: &str, segment: &ScannedSegment) -> Self {
        Self::over(disk, vec![ScannedSegment { name: name.into(), ..segment.clone() }], 1)
    }

    /// Names of files in the directory that are no segments.
    pub fn ignored(&self) -> &[String] {
        &self.ignored
    }

    /// The entry that the log follows: one that was dropped or never had, or the genesis.
    pub fn base(&self) -> Base {
        self.segments.first().map_or_else(Base::default, |oldest| oldest.header.base())
    }

    /// Names of segments that are no part of the log any more: it was begun anew after a snapshot.
    pub fn void(&self) -> &[String] {
        &self.void
    }

    pub(crate) fn segments(&self) -> &[ScannedSegment] {
        &self.segments
    }

    /// Reads only the segment with this number, counted from 0, and, if it is finished, checks that it ends where the
    /// one after it says.
    pub(crate) fn only(&self, number: usize) -> Scan<'a> {
        let segments = self.segments.iter().skip(number).take(2).cloned().collect();
        Scan::over(self.disk, segments, 1)
    }

    /// The content of the segment that was read last.
    pub(crate) fn into_contents(self) -> Contents {
        self.contents
    }

    /// Where the log ends; meaningful when the iterator has ended without an error.
    pub(crate) const fn tail(&self) -> Tail {
        let newest = Base { index: self.next_index.saturating_sub(1), term: self.last_term };
        Tail { end: self.offset, previous: self.previous, proven: self.proven, newest }
    }

    fn step(&mut self) -> Result<Option<Found>, StoreError> {
        loop {
            let Some(segment) = self.segments.get(self.at).cloned() else { return Ok(None) };
            if self.at == self.until {
                self.enter(&segment)?;
                return Ok(None);
            }
            let successor = self.segments.get(self.at + 1).map(|next| next.header.durable_upto.offset);
            let name = &segment.name;
            let read = |error| StoreError::io("read", name, error);
            if self.window.is_none() {
                self.enter(&segment)?;
                let file = self.disk.open(name).map_err(|error| StoreError::io("open", name, error))?;
                self.window = Some(Window::new(file).map_err(read)?);
            }
            let next_index = self.next_index;
            let corrupt = |offset, what: &str| StoreError::corrupt(name, offset, what, next_index);
            let Some(window) = &mut self.window else { return Ok(None) };
            if successor.map(u64::from) == Some(self.offset) {
                if let Some(offset) = window.first_non_zero(self.offset).map_err(read)? {
                    return Err(corrupt(offset, "only zeros may follow the last record of a finished segment"));
                }
                self.window = None;
                self.at += 1;
                continue;
            }
            let offset = self.offset;
            let position = LogPosition { sequence: segment.header.sequence, offset: narrow(offset) };
            let what = match decode_at(window, &segment, position, self.previous).map_err(read)? {
                Ok((header, record)) => {
                    let end = offset + header.record_bytes() as u64;
                    if successor.is_some_and(|successor| end > u64::from(successor)) {
                        return Err(corrupt(offset, "the record extends beyond the end of this segment"));
                    }
                    self.offset = end;
                    self.previous = header.crc;
                    if header.durable_upto.sequence == position.sequence {
                        self.proven = self.proven.max(u64::from(header.durable_upto.offset));
                    }
                    match &record {
                        Record::Entry(entry) => {
                            self.next_index = entry.index.saturating_add(1);
                            self.last_term = entry.term;
                            self.contents.add(entry.index, entry.term, position.offset);
                        }
                        Record::Seal(seal) if self.sealed.as_ref().is_some_and(|wanted| wanted != seal) => {
                            return Err(corrupt(offset, "the seal does not match the segment before"));
                        }
                        Record::Seal(_) | Record::HardState(_) => {}
                    }
                    let bytes = narrow(header.record_bytes() as u64);
                    let durable_upto = header.durable_upto;
                    return Ok(Some(Found::Record { file: name.clone(), position, bytes, durable_upto, record }));
                }
                Err(what) => what,
            };
            if successor.is_some() {
                let what = format!("{what}, and a later segment proves that it was durable");
                return Err(corrupt(offset, &what));
            }
            self.done = true;
            let Some(last) = window.last_non_zero(offset).map_err(read)? else { return Ok(None) };
            if let Some(proof) = find_proof(window, &segment, position, last).map_err(read)? {
                let what = format!("{what}, and the record at byte {proof} proves that it was durable");
                return Err(corrupt(offset, &what));
            }
            return Ok(Some(Found::Torn { file: name.clone(), offset, bytes: last + 1 - offset, what }));
        }
    }

    /// Checks that a segment continues the one before, and starts with its first record.
    fn enter(&mut self, segment: &ScannedSegment) -> Result<(), StoreError> {
        if segment.header.previous != self.previous {
            let what = "the header does not name the last record of the segment before";
            return Err(StoreError::corrupt(&segment.name, 72, what, self.next_index));
        }
        if segment.header.first_index != self.next_index {
            let what =
                format!("the header says entry {} comes next, found {}", segment.header.first_index, self.next_index);
            return Err(StoreError::corrupt(&segment.name, 48, what, self.next_index));
        }
        if segment.header.previous_term != self.last_term {
            let what = format!(
                "the header names term {} for the entry before, found {}",
                segment.header.previous_term, self.last_term
            );
            return Err(StoreError::corrupt(&segment.name, 76, what, self.next_index));
        }
        let contents = std::mem::take(&mut self.contents);
        let before = self.at.checked_sub(1).and_then(|before| self.segments.get(before));
        self.sealed = before.map(|before| Seal { segment_crc: before.crc, contents });
        self.offset = HEADER_BYTES;
        self.proven = HEADER_BYTES;
        self.previous = segment.crc;
        Ok(())
    }
}

impl Iterator for Scan<'_> {
    type Item = Result<Found, StoreError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let item = self.step().transpose();
        self.done |= !matches!(item, Some(Ok(_)));
        item
    }
}

type Decoded = Result<(RecordHeader, Record), &'static str>;

/// Reads the record at `position`, which has to name `previous`.
fn decode_at(
    window: &mut Window,
    segment: &ScannedSegment,
    position: LogPosition,
    previous: u32,
) -> std::io::Result<Decoded> {
    let offset = u64::from(position.offset);
    let header = match RecordHeader::decode(window.get(offset, RECORD_HEADER_BYTES)?, segment.header.salt, position) {
        Ok(header) if header.previous == previous => header,
        Ok(_) => return Ok(Err("the record does not continue the one before")),
        Err(what) => return Ok(Err(what)),
    };
    let payload = window.get(offset + RECORD_HEADER_BYTES as u64, header.length as usize)?;
    Ok(decode_record(&header, payload).map(|record| (header, record)))
}

/// Looks behind a bad record for one that was written when the bad one was already durable.
fn find_proof(
    window: &mut Window,
    segment: &ScannedSegment,
    bad: LogPosition,
    last: u64,
) -> std::io::Result<Option<u64>> {
    for offset in u64::from(bad.offset) + 1..=last {
        let bytes = window.get(offset, RECORD_HEADER_BYTES)?;
        let position = LogPosition { sequence: bad.sequence, offset: narrow(offset) };
        if RecordHeader::decode(bytes, segment.header.salt, position).is_ok_and(|header| header.durable_upto > bad) {
            return Ok(Some(offset));
        }
    }
    Ok(None)
}

/// Offsets of real segments fit; one that does not fit becomes an offset at which nothing parses.
fn narrow(offset: u64) -> u32 {
    u32::try_from(offset).unwrap_or(u32::MAX)
}
