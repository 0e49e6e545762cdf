//! The log that is also the block store: entries and hard state, on disk with one `fdatasync` a flush.
//!
//! Life of an entry: [`BlockStore::append`] stages it in memory, where it can be read at once. [`BlockStore::flush`]
//! makes it durable; then it may leave the memory and is read from its segment. A background thread calls
//! [`BlockStore::prepare`] now and then, so that flushes write into space that is already there.
//!
//! Nothing is truncated in place: an entry of a lower index supersedes what follows it. A committed entry is never
//! superseded. The log need not begin at 1: [`BlockStore::prune`] drops old segments, and [`BlockStore::begin_after`]
//! lets a node that is far behind go on after a snapshot.
//!
//! When the disk fails: any failed write or sync poisons the store, and every later `append`, `flush` and `prepare`
//! returns that first error; entries can still be read. The node ends, and the next start decides by what is on disk.
//! Only a full disk is different. The write is undone (zeroed, the file shortened to what it was, or the new file
//! removed), and staged entries stay staged. A later `flush` may succeed. If undoing fails, or if it is the sync that
//! reports the lack of space, the store is poisoned.

mod ahead;
mod check;
mod files;
mod first;
mod index;
mod lock;
mod oldest;
mod read;
mod recent;
mod recovery;
mod state;
mod writer;

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard};

use ahead::{Ahead, Marks};
use files::Files;
use lock::lock;
use oldest::{Beginning, Oldest};
use state::{Staged, State};
use writer::{Failure, Writer, Written};

use crate::disk::Disk;
use crate::entry::{Entry, HardState};
use crate::segment::{ENTRY_BYTES_MAX, HEADER_BYTES, Record, SEGMENT_BYTES_MAX};

pub use crate::segment::{Base, StoreError};

pub use first::Finished;
pub use oldest::check_oldest;
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
/// Locks are taken in the order of the fields; input and output happen under the first three only.
pub struct BlockStore {
    /// Held by the one who drops segments, who notes first which one is the oldest then.
    dropping: Mutex<Oldest>,
    /// The end of the log; held by the one who flushes.
    writer: Mutex<Writer>,
    /// The zeroed space ahead; held by the one who prepares, and by a flush that goes beyond the zeros.
    ahead: Mutex<Ahead>,
    /// The state for readers; held shortly.
    state: Mutex<State>,
    marks: Marks,
    files: Files,
    disk: Arc<dyn Disk>,
    segment_bytes: u64,
}

impl BlockStore {
    /// Opens the store in `disk`, which may be empty.
    ///
    /// A torn tail is zeroed and reported. Damage to what had been durable is [`StoreError::Corrupt`] with file and
    /// offset, and nothing is changed: this node then has to get its blocks from its peers again. One thing cannot be
    /// told from a torn write: damage to the very last flush, as nothing that was written later vouches for it.
    ///
    /// Only the newest segment is read whole, so that the time does not grow with the log. Of finished ones headers and
    /// lengths are checked; damage to a record in them is found before it is used, by whoever reads it, and by
    /// [`check_finished`](Self::check_finished).
    pub fn open(disk: Arc<dyn Disk>, options: Options) -> Result<(Self, Recovery), StoreError> {
        let Options { network, segment_bytes, cache_bytes, salt } = options;
        if segment_bytes <= HEADER_BYTES || segment_bytes > SEGMENT_BYTES_MAX {
            return Err(StoreError::Options(format!(
                "segments of {segment_bytes} bytes are not possible: choose more than {HEADER_BYTES} and at most \
                 {SEGMENT_BYTES_MAX}"
            )));
        }
        let found = recovery::recover(disk.as_ref(), &network, cache_bytes)?;
        let mut oldest = Oldest::read(Arc::clone(&disk))?;
        // A store that is made now begins with its first segment, whenever that comes.
        let begins = found.segments.front().map_or(Beginning { sequence: 1, first_index: 1 }, |segment| Beginning {
            sequence: segment.sequence,
            first_index: segment.first_index,
        });
        match oldest.note(begins) {
            // The next start notes it.
            Err(StoreError::DiskFull { .. }) => {}
            noted => noted?,
        }
        let marks = Marks::default();
        marks.position.store(found.tail.end, Ordering::Release);
        marks.zeroed.store(found.length, Ordering::Release);
        let ahead = Ahead {
            active: found.active.as_ref().map(|active| (active.segment.name.clone(), Arc::clone(&active.file))),
            spare: None,
            newest: found.active.as_ref().map_or(0, |active| active.segment.sequence),
            beginning: false,
        };
        let writer = Writer {
            disk: Arc::clone(&disk),
            network,
            segment_bytes,
            salt,
            active: found.active,
            end: found.tail.end,
            previous: found.tail.previous,
            newest: found.tail.newest,
            contents: found.contents,
            hard_state: found.written,
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
            dropping: Mutex::new(oldest),
            writer: Mutex::new(writer),
            ahead: Mutex::new(ahead),
            state: Mutex::new(state),
            marks,
            files: Files::new(Arc::clone(&disk)),
            disk,
            segment_bytes,
        };
        Ok((store, found.report))
    }

    /// Stages entries and hard state: readable at once, on disk after the next [`flush`](Self::flush).
    ///
    /// `entries` are gapless and start at the end of the log or before; then they supersede what is there. On an error
    /// nothing is staged. The orderer is broken if it supersedes a committed entry, lets a term fall, or commits what
    /// is not in the log. Then the answer is [`StoreError::Violation`], and the store is poisoned.
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

    /// Writes zeros ahead of the log, at most 1 MiB a call, in the file being written or in the next one. For a
    /// background thread: call it after flushes until it returns false (nothing to do now).
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

    /// Are few zeros left ahead of the log, so that [`prepare`](Self::prepare) should not wait? Cheap.
    pub fn wants_preparing(&self) -> bool {
        self.marks.are_low(self.segment_bytes)
    }

    /// Notes that everything up to `index` is committed, so that it is never superseded. Never goes back. An index
    /// beyond the log poisons the store.
    pub fn set_committed(&self, index: u64) {
        let mut state = self.state();
        let last = state.index.last();
        if index > last {
            state.poison(StoreError::Violation(format!(
                "entry {index} is marked as committed, but the log ends at \
                                                        {last}"
            )));
            return;
        }
        state.committed = state.committed.max(index);
    }

    /// Newest index known to be committed.
    pub fn committed(&self) -> u64 {
        self.state().committed
    }

    /// Oldest entry. With an empty log it is one above [`last_index`](Self::last_index).
    pub fn first_index(&self) -> u64 {
        self.state().index.base().index + 1
    }

    /// Newest entry, durable or not; one below [`first_index`](Self::first_index) if there is none.
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

    /// Term of an entry, without reading the disk; also of the one before the first, which is 0 for index 0.
    pub fn term(&self, index: u64) -> Option<u64> {
        self.state().index.term(index)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}
