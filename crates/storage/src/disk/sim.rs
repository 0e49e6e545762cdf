//! A disk in memory that does on purpose what real ones do by accident. Deterministic: the seed decides.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::{Disk, DiskFile};

/// Unit in which an unsynced write survives a crash or does not.
const SECTOR_BYTES: u64 = 512;

/// The fault that one call shall have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The call fails with an I/O error and does nothing. A failed sync loses what it should have made durable: the
    /// bytes stay readable until the crash, and no later sync saves them.
    Error,
    /// A write stores this many bytes, then fails with an I/O error.
    Short(usize),
    /// A write stores this many bytes, then fails because the disk is full.
    Full(usize),
}

/// A directory in memory. Clones share it, as processes share a disk.
#[derive(Clone)]
pub struct SimDisk(Arc<Mutex<Inner>>);

type Hook = Arc<dyn Fn() + Send + Sync>;

struct Inner {
    /// State of the pseudo-random sequence (splitmix64).
    random: u64,
    /// Names as running processes see them.
    names: BTreeMap<String, usize>,
    /// Names as they are after a crash.
    durable_names: BTreeMap<String, usize>,
    /// Changes of names since the last sync of the directory, oldest first.
    pending_names: Vec<NameChange>,
    files: Vec<FileState>,
    /// Counts crashes: handles opened before one are dead.
    generation: u64,
    /// How many bytes all files together may have.
    capacity_bytes: Option<u64>,
    /// Calls so far, and those that are to fail.
    reads: u64,
    writes: u64,
    syncs: u64,
    read_faults: BTreeSet<u64>,
    write_faults: BTreeMap<u64, Fault>,
    sync_faults: BTreeMap<u64, Fault>,
    dir_sync_fails: bool,
    before_sync: Option<Hook>,
}

#[derive(Clone)]
enum NameChange {
    Set(String, usize),
    Remove(String),
}

#[derive(Default)]
struct FileState {
    /// Content as running processes see it.
    cache: Vec<u8>,
    /// Content that survives every crash.
    durable: Vec<u8>,
    /// Changes since the last sync, oldest first.
    pending: Vec<Change>,
}

enum Change {
    Write(u64, Vec<u8>),
    SetLen(u64),
}

impl SimDisk {
    /// An empty directory.
    pub fn new(seed: u64) -> Self {
        Self(Arc::new(Mutex::new(Inner {
            random: seed,
            names: BTreeMap::new(),
            durable_names: BTreeMap::new(),
            pending_names: Vec::new(),
            files: Vec::new(),
            generation: 0,
            capacity_bytes: None,
            reads: 0,
            writes: 0,
            syncs: 0,
            read_faults: BTreeSet::new(),
            write_faults: BTreeMap::new(),
            sync_faults: BTreeMap::new(),
            dir_sync_fails: false,
            before_sync: None,
        })))
    }

    /// Power fails: handles die, of every unsynced change any part (sector by sector) is lost, faults are forgotten.
    pub fn crash(&self) {
        let mut inner = self.inner();
        inner.generation += 1;
        inner.read_faults.clear();
        inner.write_faults.clear();
        inner.sync_faults.clear();
        inner.dir_sync_fails = false;
        let pending = inner.pending_names.len() as u64;
        let kept = inner.below(pending + 1) as usize;
        let changes = std::mem::take(&mut inner.pending_names);
        for change in changes.into_iter().take(kept) {
            change.apply(&mut inner.durable_names);
        }
        inner.names = inner.durable_names.clone();
        let mut files = std::mem::take(&mut inner.files);
        for file in &mut files {
            file.crash(&mut inner);
        }
        inner.files = files;
        inner.free();
    }

    /// The process is killed but the machine goes on: handles die, the page cache stays.
    pub fn kill(&self) {
        let mut inner = self.inner();
        inner.generation += 1;
        inner.free();
    }

    /// Rot: flips one bit of a file, for good. False if there is no such file or bit.
    pub fn flip(&self, name: &str, bit: u64) -> bool {
        let mut inner = self.inner();
        let Some(id) = inner.names.get(name).copied() else { return false };
        let Some(file) = inner.files.get_mut(id) else { return false };
        let Ok(at) = usize::try_from(bit / 8) else { return false };
        let mut flipped = false;
        for content in [&mut file.cache, &mut file.durable] {
            if let Some(byte) = content.get_mut(at) {
                *byte ^= 1 << (bit % 8);
                flipped = true;
            }
        }
        flipped
    }

    /// Makes the `nth` read from now (1 = the next) fail.
    pub fn fail_read(&self, nth: u64) {
        let mut inner = self.inner();
        let at = inner.reads + nth;
        inner.read_faults.insert(at);
    }

    /// Makes the `nth` write from now (1 = the next) go wrong.
    pub fn fail_write(&self, nth: u64, fault: Fault) {
        let mut inner = self.inner();
        let at = inner.writes + nth;
        inner.write_faults.insert(at, fault);
    }

    /// Makes the `nth` sync of a file from now (1 = the next) fail.
    pub fn fail_sync(&self, nth: u64) {
        let mut inner = self.inner();
        let at = inner.syncs + nth;
        inner.sync_faults.insert(at, Fault::Error);
    }

    /// Makes every sync of the directory fail until the next crash.
    pub fn fail_dir_sync(&self) {
        self.inner().dir_sync_fails = true;
    }

    /// Limits how many bytes all files together may have.
    pub fn set_capacity(&self, bytes: Option<u64>) {
        self.inner().capacity_bytes = bytes;
    }

    /// Bytes that still fit; none if there is no limit.
    pub fn free_bytes(&self) -> Option<u64> {
        let inner = self.inner();
        inner.capacity_bytes.map(|capacity| capacity.saturating_sub(inner.used_bytes()))
    }

    /// Calls `hook` at the start of every sync of a file, outside of any lock of the disk.
    pub fn before_sync(&self, hook: impl Fn() + Send + Sync + 'static) {
        self.inner().before_sync = Some(Arc::new(hook));
    }

    /// Writes and syncs of files so far.
    pub fn counts(&self) -> (u64, u64) {
        let inner = self.inner();
        (inner.writes, inner.syncs)
    }

    /// Bytes of all files.
    pub fn used_bytes(&self) -> u64 {
        self.inner().used_bytes()
    }

    /// A file as running processes see it.
    pub fn contents(&self, name: &str) -> Option<Vec<u8>> {
        let inner = self.inner();
        inner.names.get(name).and_then(|id| inner.files.get(*id)).map(|file| file.cache.clone())
    }

    /// Replaces (or creates) a file, durably.
    pub fn set_contents(&self, name: &str, bytes: &[u8]) {
        let mut inner = self.inner();
        let id = inner.files.len();
        inner.files.push(FileState { cache: bytes.to_vec(), durable: bytes.to_vec(), pending: Vec::new() });
        inner.names.insert(name.to_owned(), id);
        inner.durable_names.insert(name.to_owned(), id);
    }

    /// A new disk that holds a durable copy of every file.
    pub fn copy(&self, seed: u64) -> Self {
        let copy = Self::new(seed);
        let inner = self.inner();
        for (name, id) in &inner.names {
            if let Some(file) = inner.files.get(*id) {
                copy.set_contents(name, &file.cache);
            }
        }
        copy
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn handle(&self, id: usize, generation: u64) -> Arc<dyn DiskFile> {
        Arc::new(SimFile { disk: self.clone(), id, generation })
    }
}

impl Disk for SimDisk {
    fn open(&self, name: &str) -> io::Result<Arc<dyn DiskFile>> {
        let inner = self.inner();
        let id = *inner.names.get(name).ok_or_else(|| not_found(name))?;
        Ok(self.handle(id, inner.generation))
    }

    fn create(&self, name: &str) -> io::Result<Arc<dyn DiskFile>> {
        let mut inner = self.inner();
        if inner.capacity_bytes.is_some_and(|capacity| inner.used_bytes() >= capacity) {
            return Err(ErrorKind::StorageFull.into());
        }
        let id = inner.files.len();
        inner.files.push(FileState::default());
        inner.change_name(NameChange::Set(name.to_owned(), id));
        Ok(self.handle(id, inner.generation))
    }

    fn list(&self) -> io::Result<Vec<String>> {
        Ok(self.inner().names.keys().cloned().collect())
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        let mut inner = self.inner();
        let id = *inner.names.get(from).ok_or_else(|| not_found(from))?;
        inner.change_name(NameChange::Set(to.to_owned(), id));
        inner.change_name(NameChange::Remove(from.to_owned()));
        Ok(())
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        let mut inner = self.inner();
        inner.names.get(name).ok_or_else(|| not_found(name))?;
        inner.change_name(NameChange::Remove(name.to_owned()));
        Ok(())
    }

    fn sync_dir(&self) -> io::Result<()> {
        let mut inner = self.inner();
        if inner.dir_sync_fails {
            return Err(io::Error::other("simulated failure of a directory sync"));
        }
        inner.pending_names.clear();
        inner.durable_names = inner.names.clone();
        Ok(())
    }
}

impl Inner {
    fn used_bytes(&self) -> u64 {
        self.names.values().filter_map(|id| self.files.get(*id)).map(|file| file.cache.len() as u64).sum()
    }

    /// Gives back the memory of files that nobody can reach any more; only when all handles are dead.
    fn free(&mut self) {
        let pending = self.pending_names.iter().filter_map(|change| match change {
            NameChange::Set(_, id) => Some(*id),
            NameChange::Remove(_) => None,
        });
        let reachable: BTreeSet<usize> =
            pending.chain(self.names.values().copied()).chain(self.durable_names.values().copied()).collect();
        for (id, file) in self.files.iter_mut().enumerate() {
            if !reachable.contains(&id) {
                *file = FileState::default();
            }
        }
    }

    fn change_name(&mut self, change: NameChange) {
        change.clone().apply(&mut self.names);
        self.pending_names.push(change);
    }

    /// The next number of the sequence below `limit` (which is not 0).
    fn below(&mut self, limit: u64) -> u64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.random;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % limit
    }
}

impl NameChange {
    fn apply(self, names: &mut BTreeMap<String, usize>) {
        match self {
            Self::Set(name, id) => names.insert(name, id),
            Self::Remove(name) => names.remove(&name),
        };
    }
}

impl FileState {
    /// Keeps of the unsynced changes what the seed decides: everything, nothing, or any of their sectors.
    fn crash(&mut self, inner: &mut Inner) {
        let luck = inner.below(4);
        for change in std::mem::take(&mut self.pending) {
            match change {
                Change::SetLen(bytes) if luck != 0 => self.durable.resize(bytes as usize, 0),
                Change::SetLen(_) => {}
                Change::Write(offset, data) => {
                    let mut done = 0;
                    while done < data.len() {
                        let at = offset + done as u64;
                        let room = SECTOR_BYTES - at % SECTOR_BYTES;
                        let mut count = (data.len() - done).min(room as usize);
                        let end = done + count;
                        let kept = luck == 1 || (luck > 1 && inner.below(2) == 0);
                        if luck == 3 && inner.below(8) == 0 {
                            count = inner.below(count as u64 + 1) as usize;
                        }
                        if let Some(piece) = data.get(done..done + count).filter(|_| kept) {
                            put(&mut self.durable, piece, at);
                        }
                        done = end;
                    }
                }
            }
        }
        self.cache.clone_from(&self.durable);
    }
}

struct SimFile {
    disk: SimDisk,
    id: usize,
    generation: u64,
}

impl SimFile {
    fn with<T>(&self, work: impl FnOnce(&mut Inner) -> io::Result<T>) -> io::Result<T> {
        let mut inner = self.disk.inner();
        if inner.generation != self.generation {
            return Err(io::Error::other("this handle was opened before the crash"));
        }
        work(&mut inner)
    }
}

impl DiskFile for SimFile {
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        self.with(|inner| {
            inner.reads += 1;
            if inner.read_faults.remove(&inner.reads) {
                return Err(io::Error::other("simulated failure of a read"));
            }
            let file = inner.files.get(self.id).ok_or_else(|| not_found("file"))?;
            let rest = file.cache.get(offset as usize..).unwrap_or_default();
            let count = rest.len().min(buf.len());
            for (to, from) in buf.iter_mut().zip(rest) {
                *to = *from;
            }
            Ok(count)
        })
    }

    fn write_at(&self, buf: &[u8], offset: u64) -> io::Result<()> {
        self.with(|inner| {
            inner.writes += 1;
            let fault = inner.write_faults.remove(&inner.writes);
            let grown = (offset + buf.len() as u64).saturating_sub(inner.length(self.id));
            let room = inner.capacity_bytes.map_or(u64::MAX, |capacity| capacity.saturating_sub(inner.used_bytes()));
            let full = io::Error::from(ErrorKind::StorageFull);
            let (count, result) = match fault {
                Some(Fault::Error) => (0, Err(io::Error::other("simulated failure of a write"))),
                Some(Fault::Short(bytes)) => (bytes, Err(io::Error::other("simulated short write"))),
                Some(Fault::Full(bytes)) => (bytes, Err(full)),
                None if grown > room => ((buf.len() as u64).saturating_sub(grown - room) as usize, Err(full)),
                None => (buf.len(), Ok(())),
            };
            let piece = buf.get(..count).unwrap_or(buf);
            if let Some(file) = inner.files.get_mut(self.id).filter(|_| !piece.is_empty()) {
                put(&mut file.cache, piece, offset);
                file.pending.push(Change::Write(offset, piece.to_vec()));
            }
            result
        })
    }

    fn sync_data(&self) -> io::Result<()> {
        let hook = self.disk.inner().before_sync.clone();
        if let Some(hook) = hook {
            hook();
        }
        self.with(|inner| {
            inner.syncs += 1;
            let fault = inner.sync_faults.remove(&inner.syncs);
            let file = inner.files.get_mut(self.id).ok_or_else(|| not_found("file"))?;
            let pending = std::mem::take(&mut file.pending);
            if fault.is_some() {
                return Err(io::Error::other("simulated failure of a sync"));
            }
            for change in pending {
                match change {
                    Change::SetLen(bytes) => file.durable.resize(bytes as usize, 0),
                    Change::Write(offset, data) => put(&mut file.durable, &data, offset),
                }
            }
            Ok(())
        })
    }

    fn len(&self) -> io::Result<u64> {
        self.with(|inner| Ok(inner.length(self.id)))
    }

    fn set_len(&self, bytes: u64) -> io::Result<()> {
        self.with(|inner| {
            let file = inner.files.get_mut(self.id).ok_or_else(|| not_found("file"))?;
            file.cache.resize(bytes as usize, 0);
            file.pending.push(Change::SetLen(bytes));
            Ok(())
        })
    }
}

impl Inner {
    fn length(&self, id: usize) -> u64 {
        self.files.get(id).map_or(0, |file| file.cache.len() as u64)
    }
}

/// Writes `piece` at `offset`, growing `bytes` with zeros where needed.
fn put(bytes: &mut Vec<u8>, piece: &[u8], offset: u64) {
    let start = offset as usize;
    let end = start + piece.len();
    if bytes.len() < end {
        bytes.resize(end, 0);
    }
    if let Some(place) = bytes.get_mut(start..end) {
        place.copy_from_slice(piece);
    }
}

fn not_found(name: &str) -> io::Error {
    io::Error::new(ErrorKind::NotFound, format!("no file {name}"))
}
