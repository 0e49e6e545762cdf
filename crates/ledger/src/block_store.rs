//! The log that is also the block store: entries and hard state, on disk with one `fdatasync` a flush.
//!
//! Life of an entry: [`BlockStore::append`] stages it in memory, where it can be read at once;
//! [`BlockStore::flush`] makes it durable; then it may leave the memory and is read from its segment. A background thread
//! calls [`BlockStore::prepare`] now and then, so that flushes write into space that is already there.
//!
//! Nothing is truncated in place: an entry of a lower index supersedes what follows it. What is committed is never
//! superseded.
//!
//! When the disk fails: any failed write or sync poisons the store, and every later `append`, `flush` and `prepare`
//! returns that first error; entries can still be read. The node ends, and the next start decides by what is on disk.
//! Only a full disk is different: the write is undone (zeroed, the file shortened to what it was, or the new file
//! removed), what was staged stays staged, and a later `flush` may succeed. If undoing fails, or if it is the sync that
//! reports the lack of space, the store is poisoned.

mod ahead;
mod error;
mod index;
mod recent;
mod recovery;
mod stored;
mod writer;

use std::ops::Range;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard};

use ahead::{Ahead, Marks};
use index::LogIndex;
use recent::{Recent, weight};
use recovery::{check_entry, check_hard_state};
use stored::StoredSegment;
use writer::{Failure, Writer, Written, lock};

use crate::disk::Disk;
use crate::entry::{Entry, HardState};
use crate::segment::{ENTRY_BYTES_MAX, HEADER_BYTES, Record, SEGMENT_BYTES_MAX};

pub use error::StoreError;
pub use recovery::{Recovery, TornTail};

/// Default size of a segment.
pub const SEGMENT_BYTES_DEFAULT: u64 = 64 << 20;

/// Default of what may stay in memory of entries that are on disk.
pub const CACHE_BYTES_DEFAULT: usize = 8 << 20;

/// Most bytes that may wait for the disk.
pub const STAGED_BYTES_MAX: usize = 128 << 20;

const _: () = assert!(STAGED_BYTES_MAX > 2 * ENTRY_BYTES_MAX);

/// How to open a store.
pub struct Options {
    /// Hash of the genesis block.
    pub network: [u8; 32],
    /// Size at which a new segment is begun, at most [`SEGMENT_BYTES_MAX`].
    pub segment_bytes: u64,
    /// How many bytes of entries that are on disk may stay in memory.
    pub cache_bytes: usize,
    /// Source of randomness; asked once a segment. Clients must not be able to guess it: it keeps bytes that they chose
    /// from being taken for records.
    pub salt: Box<dyn FnMut() -> u64 + Send>,
}

impl Options {
    /// The defaults.
    pub fn new(network: [u8; 32], salt: impl FnMut() -> u64 + Send + 'static) -> Self {
        Self { network, segment_bytes: SEGMENT_BYTES_DEFAULT, cache_bytes: CACHE_BYTES_DEFAULT, salt: Box::new(salt) }
    }
}

/// The log of one network on one disk. Share it by reference: every method takes `&self`.
///
/// Locks are taken in the order of the fields; input and output happen under the first two only.
pub struct BlockStore {
    /// The end of the log; held by the one who flushes.
    writer: Mutex<Writer>,
    /// What is zeroed ahead; held by the one who prepares, and by a flush that goes beyond the zeros.
    ahead: Mutex<Ahead>,
    /// What readers need; held shortly.
    state: Mutex<State>,
    marks: Marks,
    disk: Arc<dyn Disk>,
    segment_bytes: u64,
}

struct State {
    index: LogIndex,
    recent: Recent,
    staged: Staged,
    /// Of what is being written, entries from this index on have been superseded since. `u64::MAX`: none.
    superseded_from: u64,
    hard_state: HardState,
    committed: u64,
    /// All segments; the one with sequence number `n` at place `n - 1`.
    segments: Vec<Arc<StoredSegment>>,
    /// The error that ended writing.
    poison: Option<StoreError>,
}

/// What waits for the disk. Entries are gapless and none is superseded.
#[derive(Default)]
struct Staged {
    entries: Vec<Entry>,
    /// Written after the entries, so that it never calls committed what is not there.
    hard_state: Option<HardState>,
    bytes: usize,
}

/// One entry to be read: in memory, or where on disk.
enum Source {
    Memory(Entry),
    Disk(u64, index::Location, Arc<StoredSegment>),
}

impl BlockStore {
    /// Opens the store in `disk`, which may be empty.
    ///
    /// A torn tail is zeroed and reported. Damage to what had been durable is [`StoreError::Corrupt`] with file and
    /// offset, and nothing is changed: this node then has to get its blocks from its peers again. One thing cannot be
    /// told from a torn write: damage to the very last flush, as nothing that was written later vouches for it.
    pub fn open(disk: Arc<dyn Disk>, options: Options) -> Result<(Self, Recovery), StoreError> {
        let Options { network, segment_bytes, cache_bytes, salt } = options;
        if segment_bytes <= HEADER_BYTES || segment_bytes > SEGMENT_BYTES_MAX {
            return Err(StoreError::Options(format!(
                "a segment of {segment_bytes} bytes is not possible: choose more than {HEADER_BYTES} and at most {SEGMENT_BYTES_MAX}"
            )));
        }
        let found = recovery::recover(disk.as_ref(), &network, cache_bytes)?;
        let active = found.segments.last().cloned();
        let marks = Marks::default();
        marks.position.store(found.tail.end, Ordering::Release);
        marks.zeroed.store(found.length, Ordering::Release);
        let ahead = Ahead {
            active: active.as_ref().map(|segment| (segment.name.clone(), Arc::clone(&segment.file))),
            spare: None,
            newest: active.as_ref().map_or(0, |segment| segment.sequence),
            beginning: false,
        };
        let writer = Writer {
            disk: Arc::clone(&disk),
            network,
            segment_bytes,
            salt,
            active,
            end: found.tail.end,
            previous: found.tail.previous,
            next_index: found.next_index,
            buffer: Vec::new(),
        };
        let state = State {
            index: found.index,
            recent: found.recent,
            staged: Staged::default(),
            superseded_from: u64::MAX,
            hard_state: found.report.hard_state,
            committed: found.report.hard_state.commit,
            segments: found.segments,
            poison: None,
        };
        let store = Self {
            writer: Mutex::new(writer),
            ahead: Mutex::new(ahead),
            state: Mutex::new(state),
            marks,
            disk,
            segment_bytes,
        };
        Ok((store, found.report))
    }

    /// Stages entries and hard state: readable at once, on disk after the next [`flush`](Self::flush).
    ///
    /// `entries` are gapless and start at the end of the log or before; then they supersede what is there. On an error
    /// nothing is staged. Superseding a committed entry, a falling term, or a hard state that commits what is not in the
    /// log means that the orderer is broken: [`StoreError::Violation`], and the store is poisoned.
    pub fn append(&self, entries: &[Entry], hard_state: Option<&HardState>) -> Result<(), StoreError> {
        let mut state = self.state();
        state.writable()?;
        state.check_limits(entries)?;
        if let Err(what) = state.check_rules(entries, hard_state) {
            return Err(state.poison(StoreError::Violation(what)));
        }
        for entry in entries {
            state.stage(entry.clone());
        }
        if let Some(new) = hard_state {
            state.hard_state = *new;
            state.committed = state.committed.max(new.commit);
            state.staged.hard_state = Some(*new);
        }
        Ok(())
    }

    /// Makes everything staged so far durable, and returns the last durable index.
    ///
    /// One write and one `fdatasync`, plus those of a new segment when one is begun. Appending and reading go on
    /// meanwhile; a second flush waits. Nothing staged: nothing is done. For errors see the head of this module.
    pub fn flush(&self) -> Result<u64, StoreError> {
        let mut writer = lock(&self.writer);
        let staged = {
            let mut state = self.state();
            state.writable()?;
            if state.staged.is_empty() {
                return Ok(state.index.durable());
            }
            state.superseded_from = u64::MAX;
            std::mem::take(&mut state.staged)
        };
        let entries = staged.entries.iter().cloned().map(Record::Entry);
        let records = entries.chain(staged.hard_state.map(Record::HardState));
        let mut written = Written::default();
        let result = writer.write(records, &self.ahead, &self.marks, &mut written);
        let mut state = self.state();
        let placed = written.entries.len();
        if let Err(what) = state.complete(written) {
            return Err(state.poison(StoreError::Violation(what)));
        }
        match result {
            Ok(()) => Ok(state.index.durable()),
            Err(Failure::Undone(error)) => {
                state.restage(staged, placed);
                Err(error)
            }
            Err(Failure::Fatal(error)) => Err(state.poison(error)),
        }
    }

    /// Writes zeros ahead of the log, at most 1 MiB a call, in the file being written or in the next one. For a background
    /// thread: call it after flushes until it returns false (nothing to do now).
    ///
    /// [`StoreError::DiskFull`] is an early warning: the store still works as long as what is prepared lasts. A failed
    /// sync poisons the store.
    pub fn prepare(&self) -> Result<bool, StoreError> {
        self.state().writable()?;
        let mut ahead = lock(&self.ahead);
        let result = ahead.prepare(self.disk.as_ref(), &self.marks, self.segment_bytes);
        drop(ahead);
        match result {
            Err(error) if !matches!(error, StoreError::DiskFull { .. }) => Err(self.state().poison(error)),
            other => other,
        }
    }

    /// Notes that everything up to `index` is committed, so that it is never superseded. Never goes back. An index beyond
    /// the log poisons the store.
    pub fn set_committed(&self, index: u64) {
        let mut state = self.state();
        let last = state.index.last();
        if index > last {
            state.poison(StoreError::Violation(format!("entry {index} is called committed, the log ends at {last}")));
            return;
        }
        state.committed = state.committed.max(index);
    }

    /// Newest index known to be committed.
    pub fn committed(&self) -> u64 {
        self.state().committed
    }

    /// Oldest entry. With an empty log it is one above [`last_index`](Self::last_index).
    pub const fn first_index(&self) -> u64 {
        1
    }

    /// Newest entry, durable or not; 0 if there is none.
    pub fn last_index(&self) -> u64 {
        self.state().index.last()
    }

    /// Newest entry that is on disk. Falls when durable entries are superseded.
    pub fn durable_index(&self) -> u64 {
        self.state().index.durable()
    }

    /// Newest hard state, durable or not.
    pub fn hard_state(&self) -> HardState {
        self.state().hard_state
    }

    /// Term of an entry, without reading the disk.
    pub fn term(&self, index: u64) -> Option<u64> {
        self.state().index.term(index)
    }

    /// One entry, or none if the log does not have it.
    pub fn entry(&self, index: u64) -> Result<Option<Entry>, StoreError> {
        let source = self.state().source(index);
        source.map(Source::read).transpose()
    }

    /// The entries of `range` that the log has, as many as fit into `bytes_max` bytes of records, but one at least.
    pub fn entries(&self, range: Range<u64>, bytes_max: usize) -> Result<Vec<Entry>, StoreError> {
        let mut sources = Vec::new();
        {
            let state = self.state();
            let mut bytes = 0_usize;
            for index in range.start.max(1)..range.end.min(state.index.last().saturating_add(1)) {
                let Some(source) = state.source(index) else { break };
                bytes = bytes.saturating_add(source.bytes());
                if bytes > bytes_max && !sources.is_empty() {
                    break;
                }
                sources.push(source);
            }
        }
        sources.into_iter().map(Source::read).collect()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

impl State {
    fn writable(&self) -> Result<(), StoreError> {
        self.poison.clone().map_or(Ok(()), Err)
    }

    /// Ends writing; returns the error that did so first.
    fn poison(&mut self, error: StoreError) -> StoreError {
        self.poison.get_or_insert(error).clone()
    }

    /// What a caller may do wrong without harm.
    fn check_limits(&self, entries: &[Entry]) -> Result<(), StoreError> {
        let mut wanted = self.index.last() + 1;
        let mut bytes = self.staged.bytes;
        for (place, entry) in entries.iter().enumerate() {
            let starts = place == 0 && (1..=wanted).contains(&entry.index);
            if !starts && entry.index != wanted {
                return Err(StoreError::Gap { found: entry.index, wanted });
            }
            wanted = entry.index.saturating_add(1);
            let found_bytes = entry.data.len();
            if found_bytes > ENTRY_BYTES_MAX {
                return Err(StoreError::TooLarge { index: entry.index, found_bytes, max_bytes: ENTRY_BYTES_MAX });
            }
            bytes = bytes.saturating_add(weight(entry));
        }
        if bytes > STAGED_BYTES_MAX && !entries.is_empty() {
            return Err(StoreError::StageFull { staged_bytes: bytes, max_bytes: STAGED_BYTES_MAX });
        }
        Ok(())
    }

    /// What only a broken orderer does.
    fn check_rules(&self, entries: &[Entry], hard_state: Option<&HardState>) -> Result<(), String> {
        if let Some(first) = entries.first() {
            check_entry(&self.index, first, self.committed)?;
        }
        for pair in entries.windows(2) {
            if let [before, after] = pair
                && after.term < before.term
            {
                return Err(format!("entry {} has term {}, the one before {}", after.index, after.term, before.term));
            }
        }
        let last = entries.last().map_or(self.index.last(), |entry| entry.index);
        hard_state.map_or(Ok(()), |new| check_hard_state(&self.hard_state, new, last))
    }

    fn stage(&mut self, entry: Entry) {
        self.superseded_from =
            if entry.index <= self.index.last() { self.superseded_from.min(entry.index) } else { self.superseded_from };
        self.index.append(entry.index, entry.term);
        self.recent.append(entry.clone());
        self.staged.push(entry);
    }

    /// Notes where entries are that became durable.
    fn complete(&mut self, written: Written) -> Result<(), String> {
        self.segments.extend(written.segments);
        for (index, location) in written.entries {
            if index < self.superseded_from && !self.index.place(index, location) {
                return Err(format!("entry {index} was written, the log on disk ended at {}", self.index.durable()));
            }
        }
        self.recent.trim(self.index.durable());
        Ok(())
    }

    /// Takes back what could not be written: all but the first `placed` entries.
    fn restage(&mut self, staged: Staged, placed: usize) {
        let since = std::mem::take(&mut self.staged);
        let kept = staged.entries.into_iter().skip(placed).filter(|entry| entry.index < self.superseded_from);
        for entry in kept.collect::<Vec<_>>().into_iter().chain(since.entries) {
            self.staged.push(entry);
        }
        self.staged.hard_state = since.hard_state.or(staged.hard_state);
    }

    fn source(&self, index: u64) -> Option<Source> {
        if let Some(entry) = self.recent.get(index) {
            return Some(Source::Memory(entry.clone()));
        }
        let location = self.index.location(index)?;
        let segment = self.segments.get(usize::try_from(location.sequence.checked_sub(1)?).ok()?)?;
        Some(Source::Disk(index, location, Arc::clone(segment)))
    }
}

impl Staged {
    const fn is_empty(&self) -> bool {
        self.entries.is_empty() && self.hard_state.is_none()
    }

    /// Adds an entry; those it supersedes never need to be written.
    fn push(&mut self, entry: Entry) {
        while let Some(last) = self.entries.last().filter(|last| last.index >= entry.index) {
            self.bytes -= weight(last);
            self.entries.pop();
        }
        self.bytes += weight(&entry);
        self.entries.push(entry);
    }
}

impl Source {
    fn bytes(&self) -> usize {
        match self {
            Self::Memory(entry) => weight(entry),
            Self::Disk(_, location, _) => location.bytes as usize,
        }
    }

    fn read(self) -> Result<Entry, StoreError> {
        match self {
            Self::Memory(entry) => Ok(entry),
            Self::Disk(index, location, segment) => segment.read(index, location),
        }
    }
}
