//! Puts staged records on disk: one write and one `fdatasync` a flush, as long as it fits into the segment.

use std::io::ErrorKind;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use super::StoreError;
use super::ahead::{Ahead, Marks, Spare, write_zeros};
use super::files::StoredSegment;
use super::lock::lock;
use crate::disk::{Disk, DiskFile};
use crate::entry::{Entry, HardState};
use crate::segment::{
    Base, Contents, LogPosition, Record, SEAL_BYTES_MAX, Seal, SegmentHeader, encode_record, encoded_bytes,
    segment_name,
};
use ledger_base::mutation::{Mutation, active};

/// A buffer larger than this is given back after use.
const BUFFER_KEPT_BYTES: usize = 1 << 20;

/// The end of the log. Used by one flusher at a time.
pub(super) struct Writer {
    pub(super) disk: Arc<dyn Disk>,
    pub(super) network: [u8; 32],
    pub(super) segment_bytes: u64,
    pub(super) salt: Box<dyn FnMut() -> u64 + Send>,
    /// The newest segment and its file; none in a new store.
    pub(super) active: Option<Active>,
    /// End of its records.
    pub(super) end: u64,
    /// CRC the next record names.
    pub(super) previous: u32,
    /// Index and term of the newest entry written.
    pub(super) newest: Base,
    /// The content of the newest segment, for the seal in the next one.
    pub(super) contents: Contents,
    /// The newest hard state written: every segment begins with one, so that older segments can be dropped.
    pub(super) hard_state: HardState,
    /// Reused for encoding.
    pub(super) buffer: Vec<u8>,
}

/// The segment that is being written.
#[derive(Clone)]
pub(super) struct Active {
    pub(super) segment: Arc<StoredSegment>,
    pub(super) file: Arc<dyn DiskFile>,
}

/// The entries that became durable.
#[derive(Default)]
pub(super) struct Written {
    pub(super) entries: Vec<Placed>,
    pub(super) segments: Vec<Arc<StoredSegment>>,
}

/// An entry, and where its record starts.
#[derive(Clone, Copy)]
pub(super) struct Placed {
    pub(super) index: u64,
    pub(super) term: u64,
    pub(super) position: LogPosition,
}

/// Why a flush failed.
pub(super) enum Failure {
    /// The disk is full, and what was begun has been undone: the rest may be tried again.
    Undone(StoreError),
    /// Nothing is known about what is on disk.
    Fatal(StoreError),
}

/// One write: what is in the buffer, and where it goes.
struct Run {
    /// The segment to be, if the run starts one.
    fresh: Option<Fresh>,
    /// Offset of the buffer's first byte.
    start: u64,
    previous: u32,
    /// The log is on disk up to here before anything of the run is.
    durable_upto: LogPosition,
    entries: Vec<Placed>,
    newest: Base,
    hard_state: HardState,
}

struct Fresh {
    spare: Spare,
    segment: Arc<StoredSegment>,
}

impl Writer {
    /// Writes and syncs `records`. `written` tells what is durable, also after a failure.
    pub(super) fn write(
        &mut self,
        records: impl Iterator<Item = Record>,
        ahead: &Mutex<Ahead>,
        marks: &Marks,
        written: &mut Written,
    ) -> Result<(), Failure> {
        let result = self.write_runs(records, ahead, marks, written);
        if !matches!(result, Err(Failure::Fatal(_))) {
            lock(ahead).beginning = false;
        }
        result
    }

    fn write_runs(
        &mut self,
        records: impl Iterator<Item = Record>,
        ahead: &Mutex<Ahead>,
        marks: &Marks,
        written: &mut Written,
    ) -> Result<(), Failure> {
        let mut run = self.continue_segment();
        for record in records {
            let at = run.start + self.buffer.len() as u64;
            // A record larger than a segment gets one of its own.
            let fits = at + encoded_bytes(&record) as u64 <= self.segment_bytes;
            if (run.fresh.is_none() && self.active.is_none()) || !fits {
                self.commit(run, ahead, marks, written)?;
                run = self.begin_segment(self.durable(), ahead)?;
            }
            self.encode(&mut run, &record)?;
        }
        self.commit(run, ahead, marks, written)
    }

    /// Begins the log anew, after `base`: what is in older segments is void as soon as this one has its name.
    pub(super) fn begin_after(
        &mut self,
        base: Base,
        hard_state: HardState,
        ahead: &Mutex<Ahead>,
        marks: &Marks,
    ) -> Result<Arc<StoredSegment>, Failure> {
        let before = (self.newest, self.hard_state, self.previous);
        (self.newest, self.hard_state, self.previous) = (base, hard_state, 0);
        let mut written = Written::default();
        let result = self
            .begin_segment(LogPosition::default(), ahead)
            .and_then(|run| self.commit(run, ahead, marks, &mut written));
        if !matches!(result, Err(Failure::Fatal(_))) {
            lock(ahead).beginning = false;
        }
        if let Err(failure) = result {
            (self.newest, self.hard_state, self.previous) = before;
            return Err(failure);
        }
        let none = || Failure::Fatal(StoreError::Violation("no segment was begun".to_owned()));
        written.segments.pop().ok_or_else(none)
    }

    /// Adds a record to the run.
    fn encode(&mut self, run: &mut Run, record: &Record) -> Result<(), Failure> {
        let active = self.active.as_ref().map(|active| &active.segment);
        let Some(segment) = run.fresh.as_ref().map(|fresh| &fresh.segment).or(active) else {
            return Err(Failure::Fatal(StoreError::Violation("no segment to write to".to_owned())));
        };
        let at = run.start + self.buffer.len() as u64;
        let offset = u32::try_from(at)
            .map_err(|_| Failure::Fatal(StoreError::Violation(format!("{} is too long", segment.name))))?;
        let durable_upto = run.durable_upto;
        run.previous = encode_record(record, segment.salt, offset, run.previous, durable_upto, &mut self.buffer);
        match record {
            Record::Entry(Entry { index, term, .. }) => {
                let position = LogPosition { sequence: segment.sequence, offset };
                run.entries.push(Placed { index: *index, term: *term, position });
                run.newest = Base { index: *index, term: *term };
            }
            Record::HardState(hard_state) => run.hard_state = *hard_state,
            Record::Seal(_) => {}
        }
        Ok(())
    }

    /// Everything before this is on disk.
    fn durable(&self) -> LogPosition {
        let end = u32::try_from(self.end).unwrap_or(u32::MAX);
        self.active
            .as_ref()
            .map_or_else(LogPosition::default, |active| LogPosition { sequence: active.segment.sequence, offset: end })
    }

    fn continue_segment(&mut self) -> Run {
        self.buffer.clear();
        self.buffer.shrink_to(BUFFER_KEPT_BYTES);
        self.run(None, self.end, self.previous, self.durable())
    }

    fn run(&self, fresh: Option<Fresh>, start: u64, previous: u32, durable_upto: LogPosition) -> Run {
        let (newest, hard_state) = (self.newest, self.hard_state);
        Run { fresh, start, previous, durable_upto, entries: Vec::new(), newest, hard_state }
    }

    /// `durable_upto`: end of the log so far, or the default if the log begins with this segment.
    fn begin_segment(&mut self, durable_upto: LogPosition, ahead: &Mutex<Ahead>) -> Result<Run, Failure> {
        let sequence = self.durable().sequence + 1;
        let spare = {
            let mut ahead = lock(ahead);
            ahead.beginning = true;
            ahead.spare.take()
        };
        let spare = match spare {
            Some(spare) => spare,
            None => Spare::create(self.disk.as_ref(), sequence).map_err(|error| match error {
                full @ StoreError::DiskFull { .. } => Failure::Undone(full),
                other => Failure::Fatal(other),
            })?,
        };
        let header = SegmentHeader {
            sequence,
            network: self.network,
            first_index: self.newest.index + 1,
            salt: (self.salt)(),
            durable_upto,
            previous: self.previous,
            previous_term: self.newest.term,
        };
        let (bytes, crc) = header.encode();
        self.buffer.clear();
        self.buffer.extend(bytes);
        let segment = Arc::new(StoredSegment {
            name: segment_name(sequence, header.first_index),
            sequence,
            crc,
            salt: header.salt,
            first_index: header.first_index,
            bytes_before: durable_upto.offset,
        });
        let mut run = self.run(Some(Fresh { spare, segment }), 0, crc, durable_upto);
        if self.hard_state != HardState::default() {
            self.encode(&mut run, &Record::HardState(self.hard_state))?;
        }
        if let Some(seal) = self.seal().filter(|_| !header.begins_log()) {
            self.encode(&mut run, &Record::Seal(seal))?;
        }
        Ok(run)
    }

    /// The seal of the newest segment for the next one; none if it would be too long.
    fn seal(&self) -> Option<Seal> {
        let segment_crc = self.active.as_ref()?.segment.crc;
        let seal = Seal { segment_crc, contents: self.contents.clone() };
        (seal.bytes() <= SEAL_BYTES_MAX).then_some(seal)
    }

    /// Puts the buffer on disk.
    fn commit(&mut self, run: Run, ahead: &Mutex<Ahead>, marks: &Marks, written: &mut Written) -> Result<(), Failure> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let end = run.start + self.buffer.len() as u64;
        match run.fresh {
            None => self.commit_in_place(run.start, end, ahead, marks)?,
            Some(fresh) => {
                self.commit_fresh(&fresh, end, ahead, marks)?;
                written.segments.push(Arc::clone(&fresh.segment));
                self.active = Some(Active { segment: fresh.segment, file: fresh.spare.file });
                self.contents = Contents::default();
            }
        }
        self.end = end;
        self.previous = run.previous;
        (self.newest, self.hard_state) = (run.newest, run.hard_state);
        for Placed { index, term, position } in &run.entries {
            self.contents.add(*index, *term, position.offset);
        }
        written.entries.extend(run.entries);
        self.buffer.clear();
        Ok(())
    }

    fn commit_in_place(&self, start: u64, end: u64, ahead: &Mutex<Ahead>, marks: &Marks) -> Result<(), Failure> {
        let Some(Active { segment, file }) = &self.active else { return Ok(()) };
        let write = || file.write_at(&self.buffer, start);
        let result = if end <= marks.zeroed.load(Ordering::Acquire) {
            marks.position.store(end, Ordering::Release);
            write()
        } else {
            // Nobody may write zeros where this write goes.
            let _ahead = lock(ahead);
            marks.position.store(end, Ordering::Release);
            let result = write();
            if result.is_ok() {
                marks.zeroed.fetch_max(end, Ordering::AcqRel);
            }
            result
        };
        match result {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::StorageFull => {
                let full = StoreError::writing("write", &segment.name, end - start, error);
                return Err(undo(&segment.name, file.as_ref(), (start, end), full, ahead, marks));
            }
            Err(error) => return Err(Failure::Fatal(StoreError::io("write", &segment.name, error))),
        }
        if active(Mutation::NoFsync) {
            return Ok(());
        }
        file.sync_data().map_err(|error| Failure::Fatal(StoreError::io("sync", &segment.name, error)))
    }

    /// The file gets its name, and the name its place, only when the content is on disk.
    fn commit_fresh(&self, fresh: &Fresh, end: u64, ahead: &Mutex<Ahead>, marks: &Marks) -> Result<(), Failure> {
        let Fresh { spare, segment } = fresh;
        if let Err(error) = spare.file.write_at(&self.buffer, 0) {
            if error.kind() != ErrorKind::StorageFull {
                return Err(Failure::Fatal(StoreError::io("write", &spare.name, error)));
            }
            let full = StoreError::writing("write", &spare.name, end, error);
            // It has no segment's name, so it is no part of the log; without it there is more room.
            let removed = self.disk.remove(&spare.name);
            removed.map_err(|error| Failure::Fatal(StoreError::io("remove", &spare.name, error)))?;
            return Err(Failure::Undone(full));
        }
        let fatal = |operation, error| Failure::Fatal(StoreError::io(operation, &spare.name, error));
        spare.file.sync_data().map_err(|error| fatal("sync", error))?;
        self.disk.rename(&spare.name, &segment.name).map_err(|error| fatal("rename", error))?;
        self.disk.sync_dir().map_err(|error| fatal("sync the directory of", error))?;
        let mut ahead = lock(ahead);
        ahead.newest = segment.sequence;
        ahead.beginning = false;
        ahead.active = Some((segment.name.clone(), Arc::clone(&spare.file)));
        marks.position.store(end, Ordering::Release);
        marks.zeroed.store(end.max(spare.zeroed), Ordering::Release);
        Ok(())
    }
}

/// Takes back a write that found the disk full, so that zeros follow the log as before.
fn undo(
    name: &str,
    file: &dyn DiskFile,
    (start, end): (u64, u64),
    full: StoreError,
    ahead: &Mutex<Ahead>,
    marks: &Marks,
) -> Failure {
    let _ahead = lock(ahead);
    let zeroed = marks.zeroed.load(Ordering::Acquire);
    let cut = || if file.len()? > zeroed { file.set_len(zeroed) } else { Ok(()) };
    let undone = cut()
        .map_err(|error| StoreError::io("shorten", name, error))
        .and_then(|()| write_zeros(file, name, start, end.min(zeroed)));
    marks.position.store(start, Ordering::Release);
    match undone {
        Ok(()) => Failure::Undone(full),
        Err(error) => Failure::Fatal(error),
    }
}
