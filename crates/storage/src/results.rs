//! Results of executed blocks, and where each transaction is: in files of their own beside the segments.
//!
//! They follow from the blocks, as the world state does: whatever is wrong with them is dropped from there on and
//! executed again. Results that were not flushed yet are in memory. [`ResultStore::flush`] makes results durable before
//! the world state's savepoint moves past them, so after a crash they reach at least as far; records beyond it are cut
//! off. The thread that executes blocks takes a lock that is held for moments only, never the one of the files, where
//! the writer may need long.
//!
//! A node that has the blocks keeps only what they do not tell. A call's arguments are in its block, and its answer and
//! events often say the same again. The chaincode can foretell that part, and it is not kept.
//!
//! A file holds some 4 MiB and is named by its first height. While it is written, its index of ids is in memory; when
//! it is finished, a sorted table at its end. Old files are dropped as a whole.

mod beside;
mod file;
mod index;
mod open;
mod place;
mod stored;
mod write;

pub use beside::Blocks;
pub use index::INDEXED_TRANSACTIONS_MAX;
pub use place::Place;
pub use stored::{SHORT_ID_BYTES, StoredResult};

use crate::disk::{Disk, DiskFile};
use crate::layout::RESULTS_DIRECTORY;
use crate::result::BlockResult;
use bytes::Bytes;
use file::{Records, ResultFile, Spot, beginnings};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// A file of this size is finished and the next one begun.
pub const RESULTS_FILE_BYTES_MAX: u64 = 4 * 1024 * 1024;

/// The results of the blocks that a node has executed.
pub struct ResultStore {
    /// None keeps results in memory until they are flushed, and then forgets them.
    disk: Option<Arc<dyn Disk>>,
    /// The blocks beside which results are kept; without them results are kept whole.
    blocks: Option<Arc<dyn Blocks>>,
    network: Hash,
    /// A result goes from `recent` into a file, where it is noted before it leaves `recent`: whoever looks into
    /// `recent` first and into `files` then finds it.
    recent: Mutex<Unwritten>,
    files: RwLock<Files>,
    /// Held while files are written.
    writing: Mutex<Writing>,
}

#[derive(Default)]
struct Writing {
    /// Results are in the file, but perhaps not on the disk.
    unsynced: bool,
    /// A sync has failed, which nothing can make good.
    failed: bool,
}

struct Files {
    /// Oldest first. Each follows the one before.
    finished: VecDeque<Arc<ResultFile>>,
    /// The one that is written.
    open: Option<Open>,
}

struct Unwritten {
    /// Results that are not in a file yet.
    pending: VecDeque<Arc<Pending>>,
    /// Bytes in `pending`.
    bytes: usize,
    /// Height of the block whose result comes next.
    next: u64,
}

/// The file that is written, and its handle.
struct Open {
    content: ResultFile,
    file: Arc<dyn DiskFile>,
}

/// The result of a block that is not in a file yet.
struct Pending {
    height: u64,
    time: u64,
    bytes: Bytes,
    /// Position and beginning of the ids that it has taken.
    taken: Vec<(u32, u64)>,
}

impl ResultStore {
    /// A store that forgets what is flushed: for verification, which needs each result once.
    pub fn in_memory() -> Self {
        Self::new(None, Hash::ZERO, VecDeque::new(), None)
    }

    fn new(
        disk: Option<Arc<dyn Disk>>,
        network: Hash,
        finished: VecDeque<Arc<ResultFile>>,
        open: Option<Open>,
    ) -> Self {
        let files = Files { finished, open };
        let recent = Mutex::new(Unwritten { pending: VecDeque::new(), bytes: 0, next: files.next() });
        Self { disk, blocks: None, network, recent, files: RwLock::new(files), writing: Mutex::default() }
    }

    /// From now on keeps of a result only what these blocks do not tell. They must have every block whose result is
    /// taken, and keep it as long as the result.
    #[must_use]
    pub fn beside(self, blocks: Arc<impl Blocks + 'static>) -> Self {
        Self { blocks: Some(blocks), ..self }
    }

    /// Does it keep what is flushed?
    pub fn is_durable(&self) -> bool {
        self.disk.is_some()
    }

    /// Height of the oldest result; [`next`](Self::next) if there is none.
    pub fn first(&self) -> u64 {
        let recent = {
            let recent = self.recent();
            recent.pending.front().map_or(recent.next, |pending| pending.height)
        };
        let files = self.files();
        let file = files.finished.front().map(|file| file.first).or(files.open.as_ref().map(|open| open.content.first));
        file.unwrap_or(recent)
    }

    /// Height of the block whose result comes next.
    pub fn next(&self) -> u64 {
        self.recent().next
    }

    /// Roughly how many bytes wait for a flush.
    pub fn pending_bytes(&self) -> usize {
        self.recent().bytes
    }

    /// Takes the result of the next block, which these [blocks](Self::beside) have. `foretold` says which transactions
    /// came out as their calls foretell.
    pub fn push(&self, height: u64, result: &BlockResult, foretold: &[bool]) -> Result<(), Rejection> {
        match self.blocks {
            Some(_) if !foretold.is_empty() => self.take(height, &StoredResult::short(result, foretold)),
            _ => self.take(height, &StoredResult::whole(result.clone())),
        }
    }

    /// Takes the result of the next block, which nobody here has.
    pub fn push_whole(&self, height: u64, result: BlockResult) -> Result<(), Rejection> {
        self.take(height, &StoredResult::whole(result))
    }

    fn take(&self, height: u64, stored: &StoredResult) -> Result<(), Rejection> {
        let pending =
            Pending { height, time: stored.time(), bytes: stored.to_bytes(), taken: beginnings(stored).collect() };
        let pending = Arc::new(pending);
        let mut recent = self.recent();
        if height != recent.next {
            return Err(Rejection::new(Code::Internal, "a result does not follow the last one")
                .found(format!("height {height}"))
                .wanted(format!("height {}", recent.next)));
        }
        recent.next += 1;
        recent.bytes += pending.weight();
        recent.pending.push_back(pending);
        Ok(())
    }

    /// The blocks that results are kept [beside](Self::beside), if they are.
    pub fn blocks(&self) -> Option<&dyn Blocks> {
        self.blocks.as_deref()
    }

    /// The kept part of the result of the block at a height; none if there is none or it was dropped.
    ///
    /// # Errors
    /// [`Code::DiskFailed`]; [`Code::Corrupt`] if it is damaged: the results are to be made again from the blocks.
    pub fn get(&self, height: u64) -> Result<Option<StoredResult>, Rejection> {
        let pending = self.recent().locate(height);
        let bytes = match pending {
            Some(pending) => pending.bytes.clone(),
            None => {
                // Files are read without a lock.
                let Some(Located { first, spot, file }) = self.files().locate(height) else { return Ok(None) };
                let file = file.map(Some).map_or_else(|| self.open_file(first), Ok)?;
                let Some(file) = file else { return Ok(None) };
                spot.read(&*file).map_err(|error| failed("read", first, &error))?
            }
        };
        StoredResult::from_bytes(bytes).map(Some)
    }

    /// Where the transaction was executed. Takes milliseconds in a long history; the window answers for the last
    /// seconds.
    ///
    /// # Errors
    /// As [`ResultStore::get`].
    pub fn find(&self, id: &Hash) -> Result<Option<Place>, Rejection> {
        let short = index::beginning(id);
        let pending: Vec<_> = self.recent().pending.iter().rev().cloned().collect();
        let places = pending.iter().flat_map(|pending| {
            let taken = pending.taken.iter().filter(|(_, beginning)| *beginning == short);
            taken.map(|(position, _)| Place { height: pending.height, position: *position })
        });
        let mut places: Vec<Place> = places.collect();
        let files: Vec<_> = {
            let files = self.files();
            if let Some(open) = &files.open {
                let items = open.content.find(|| Ok(Arc::clone(&open.file)), short).unwrap_or_default();
                places.extend(items.iter().map(|item| item.place(open.content.first)));
            }
            files.finished.iter().rev().cloned().collect()
        };
        if let Some(place) = self.first_of(id, &places)? {
            return Ok(Some(place));
        }
        for content in files {
            let Some(file) = self.open_file(content.first)? else { continue };
            let items = content.find(|| Ok(file), short).map_err(|error| failed("read", content.first, &error))?;
            places.clear();
            places.extend(items.iter().map(|item| item.place(content.first)));
            if let Some(place) = self.first_of(id, &places)? {
                return Ok(Some(place));
            }
        }
        Ok(None)
    }

    /// The place among these that is really of this id.
    fn first_of(&self, id: &Hash, places: &[Place]) -> Result<Option<Place>, Rejection> {
        for place in places {
            if self.get(place.height)?.is_some_and(|stored| stored.has(place.position, id)) {
                return Ok(Some(*place));
            }
        }
        Ok(None)
    }

    /// Calls `each` with the blocks whose time is `time` or later, in order, as they are stored.
    pub fn since(
        &self,
        time: u64,
        last: u64,
        mut each: impl FnMut(u64, StoredResult) -> Result<(), Rejection>,
    ) -> Result<(), Rejection> {
        let pending: Vec<_> = self.recent().pending.iter().cloned().collect();
        let files: Vec<Records> = {
            let files = self.files();
            let open = files.open.as_ref().map(|open| open.content.records());
            let all = files.finished.iter().map(|file| file.records()).chain(open);
            all.filter(|records| records.next > records.first && records.newest >= time).collect()
        };
        let mut give = |height: u64, bytes: Bytes| {
            let stored = StoredResult::from_bytes(bytes)?;
            if stored.time() >= time && height <= last { each(height, stored) } else { Ok(()) }
        };
        let mut next = None;
        for records in files {
            let Some(file) = self.open_file(records.first)? else { continue };
            records.since(time, &file, |error| failed("read", records.first, error), &mut give)?;
            next = Some(records.next);
        }
        for pending in pending.iter().filter(|pending| next.is_none_or(|next| pending.height >= next)) {
            give(pending.height, pending.bytes.clone())?;
        }
        Ok(())
    }

    /// None if the file was dropped in between.
    fn open_file(&self, first: u64) -> Result<Option<Arc<dyn DiskFile>>, Rejection> {
        let Some(disk) = &self.disk else { return Ok(None) };
        match disk.open(&ResultFile::name(first)) {
            Ok(file) => Ok(Some(file)),
            Err(error) if error.kind() == ErrorKind::NotFound && first < self.first() => Ok(None),
            Err(error) => Err(failed("open", first, &error)),
        }
    }

    fn recent(&self) -> MutexGuard<'_, Unwritten> {
        self.recent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn files(&self) -> RwLockReadGuard<'_, Files> {
        self.files.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn files_mut(&self) -> RwLockWriteGuard<'_, Files> {
        self.files.write().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The place of a result in the file with this first height, and the file's handle if it is open.
struct Located {
    first: u64,
    spot: Spot,
    file: Option<Arc<dyn DiskFile>>,
}

impl Unwritten {
    fn locate(&self, height: u64) -> Option<Arc<Pending>> {
        let number = height.checked_sub(self.pending.front()?.height)?;
        self.pending.get(usize::try_from(number).ok()?).map(Arc::clone)
    }
}

impl Files {
    /// Height of the block after the last.
    fn next(&self) -> u64 {
        let last = self.open.as_ref().map(|open| &open.content).or_else(|| self.finished.back().map(|file| &**file));
        last.map_or(1, ResultFile::next)
    }

    fn locate(&self, height: u64) -> Option<Located> {
        if let Some(open) = self.open.as_ref().filter(|open| open.content.first <= height) {
            let (first, file) = (open.content.first, Some(Arc::clone(&open.file)));
            return open.content.locate(height).map(|spot| Located { first, spot, file });
        }
        let after = self.finished.partition_point(|file| file.first <= height);
        let file = self.finished.get(after.checked_sub(1)?)?;
        file.locate(height).map(|spot| Located { first: file.first, spot, file: None })
    }
}

impl Pending {
    fn weight(&self) -> usize {
        self.bytes.len() + self.taken.len() * 16 + 96
    }
}

/// A fault of a file of results as a refusal.
fn failed(operation: &str, first: u64, error: &io::Error) -> Rejection {
    let code = match error.kind() {
        ErrorKind::StorageFull => Code::DiskFull,
        ErrorKind::InvalidData => Code::Corrupt,
        _ => Code::DiskFailed,
    };
    let name = ResultFile::name(first);
    let refused = Rejection::new(code, format!("cannot {operation} {RESULTS_DIRECTORY}/{name}: {error}"));
    match code {
        Code::Corrupt => refused
            .next("stop the node and delete its directories state/ and results/; both are rebuilt from the blocks"),
        _ => refused,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::disk::SimDisk;
    use std::sync::mpsc;
    use std::time::{Duration, Instant};

    /// A store with the results of so many blocks.
    fn store(blocks: u64) -> Arc<ResultStore> {
        let store = ResultStore::open(Arc::new(SimDisk::new(1)), Hash::ZERO).unwrap();
        (1..=blocks).for_each(|height| store.push_whole(height, result(height)).unwrap());
        Arc::new(store)
    }

    fn result(height: u64) -> BlockResult {
        let [hash, digest] = [Bytes::from(vec![1; 32]), Bytes::from(vec![2; 32])];
        BlockResult { term: 1, time: height, hash, digest, ..BlockResult::default() }
    }

    #[test]
    fn who_executes_blocks_does_not_wait_for_the_lock_of_the_files() {
        let store = store(1);
        let sorting = store.files_mut();
        let (done, executed) = mpsc::channel();
        let executing = Arc::clone(&store);
        std::thread::spawn(move || {
            executing.push_whole(2, result(2)).unwrap();
            assert!(executing.get(1).unwrap().is_some() && executing.get(2).unwrap().is_some());
            done.send((executing.next(), executing.pending_bytes() > 0)).unwrap();
        });
        assert_eq!(executed.recv_timeout(Duration::from_secs(60)), Ok((3, true)));
        drop(sorting);
    }

    #[test]
    fn a_file_knows_a_result_before_memory_forgets_it() {
        let store = store(3);
        let piece = store.piece(2);
        store.file_for(&SimDisk::new(2), 1).unwrap();
        let forgetting = store.recent();
        let writing = Arc::clone(&store);
        let written = std::thread::spawn(move || writing.written(&piece));
        let late = Instant::now() + Duration::from_secs(60);
        while store.files().locate(2).is_none() {
            assert!(Instant::now() < late, "it is forgotten first");
            std::thread::yield_now();
        }
        drop(forgetting);
        assert!(!written.join().unwrap(), "the file is not full");
        assert_eq!(store.recent().pending.front().map(|pending| pending.height), Some(3));
    }
}
