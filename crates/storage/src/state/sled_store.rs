//! Where a node keeps the world state between runs. The only file that knows `sled`.

use super::Store;
use super::scratch::Scratch;
use crate::state::WriteSet;
use bytes::Bytes;
use ledger_base::invariant::caught;
use ledger_base::rejection::{Code, Rejection};
use std::io::ErrorKind;
use std::ops::Bound;
use std::path::{Path, PathBuf};
use std::sync::{PoisonError, RwLock};
use std::time::Duration;

/// Bytes of sled's page cache: small, for a node on a robot; hot keys live in [`super::State`]'s memory anyway.
const CACHE_BYTES: u64 = 4 * 1024 * 1024;

/// Bytes of sled's segments: its files grow, and its buffers are made, by so much. Pages hold at most 16 keys; those
/// that are larger than a quarter of this go into files of their own.
const SEGMENT_BYTES: usize = 128 * 1024;

/// How often, and after which pause, a store is tried again whose lock is held.
const LOCK_ATTEMPTS_MAX: u32 = 100;
/// How sled 0.34 says that another has the lock: it gives no kind of error of its own (`Config::try_lock`).
const LOCKED: &str = "could not acquire lock";
const LOCK_PAUSE: Duration = Duration::from_millis(10);

/// The store on disk. sled 0.34 is called beta by its authors. Any error or panic of it means that the
/// directory is to be deleted and rebuilt from blocks, never that data is lost.
pub struct SledStore {
    directory: PathBuf,
    /// After a failed write sled answers every call with that failure, so it is opened anew. It then holds the last
    /// batch that was written whole, and [`super::State`] still has what came later. None if even that failed.
    tree: RwLock<Option<sled::Db>>,
    /// The copy that it opened, if it opened one. It goes away after the tree.
    _copy: Option<Scratch>,
}

impl SledStore {
    /// Opens or creates the store in a directory.
    ///
    /// # Errors
    /// [`Code::Corrupt`] for whatever sled reports or panics about, [`Code::DiskFull`] if there is no space.
    pub fn open(directory: &Path) -> Result<Self, Rejection> {
        Ok(Self { directory: directory.to_owned(), tree: RwLock::new(Some(open(directory)?)), _copy: None })
    }

    /// Opens a copy of a store, which goes away with the value: sled writes into what it opens. Nothing is written into the
    /// directory.
    ///
    /// # Errors
    /// As [`SledStore::open`]; the fault of the copy.
    pub fn open_copy(directory: &Path) -> Result<Self, Rejection> {
        let copy = Scratch::copy_of(directory)?;
        let tree = RwLock::new(Some(open(copy.path())?));
        Ok(Self { directory: copy.path().to_owned(), tree, _copy: Some(copy) })
    }

    fn read<T>(&self, body: impl FnOnce(&sled::Db) -> Result<T, sled::Error>) -> Result<T, Rejection> {
        match &*self.tree.read().unwrap_or_else(PoisonError::into_inner) {
            Some(tree) => guard(|| body(tree)),
            None => Err(Rejection::new(Code::DiskFailed, "the state store could not be reopened after a failure")),
        }
    }

    fn reopen(&self) {
        let mut slot = self.tree.write().unwrap_or_else(PoisonError::into_inner);
        // The old one first: it holds the lock of the directory.
        *slot = None;
        match open(&self.directory) {
            Ok(tree) => *slot = Some(tree),
            Err(fault) => {
                tracing::error!(code = fault.code.name(), reason = %fault, "cannot reopen the state store")
            }
        }
    }
}

fn config(directory: &Path) -> sled::Config {
    sled::Config::new()
        .path(directory)
        .flush_every_ms(None)
        .cache_capacity(CACHE_BYTES)
        .segment_size(SEGMENT_BYTES)
        .mode(sled::Mode::LowSpace)
}

fn open(directory: &Path) -> Result<sled::Db, Rejection> {
    let config = config(directory);
    let mut opened = caught(|| config.open());
    for _ in 0..LOCK_ATTEMPTS_MAX {
        if !matches!(&opened, Ok(Err(sled::Error::Io(error))) if error.to_string().starts_with(LOCKED)) {
            break;
        }
        // A store that was closed just now lets go of its lock only when its threads have ended.
        std::thread::sleep(LOCK_PAUSE);
        opened = caught(|| config.open());
    }
    match opened {
        Ok(Ok(tree)) => Ok(tree),
        Ok(Err(error)) => Err(fault(&error)),
        Err(panic) => {
            let message = format!("the store in {} is damaged", directory.display());
            Err(Rejection::new(Code::Corrupt, message).found(first_line(&panic)))
        }
    }
}

/// The errors and panics of sled, as a rejection.
fn guard<T>(body: impl FnOnce() -> Result<T, sled::Error>) -> Result<T, Rejection> {
    match caught(body) {
        Ok(result) => result.map_err(|error| fault(&error)),
        Err(panic) => Err(Rejection::new(Code::Corrupt, "the state store is damaged").found(first_line(&panic))),
    }
}

fn first_line(text: &str) -> &str {
    text.lines().next().unwrap_or_default()
}

fn fault(error: &sled::Error) -> Rejection {
    let code = match error {
        sled::Error::Io(io) if io.kind() == ErrorKind::StorageFull => Code::DiskFull,
        sled::Error::Io(_) => Code::DiskFailed,
        _ => Code::Corrupt,
    };
    let text = match error {
        sled::Error::Corruption { .. } => "it contains damaged data".to_owned(),
        other => other.to_string(),
    };
    Rejection::new(code, format!("the store failed: {text}"))
}

impl Store for SledStore {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        self.read(|tree| Ok(tree.get(key)?.map(|value| Bytes::copy_from_slice(&value))))
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        self.read(|tree| {
            let start = after.map_or(Bound::Included(prefix), Bound::Excluded);
            let mut pairs = Vec::new();
            for pair in tree.range::<&[u8], _>((start, Bound::Unbounded)).take(limit) {
                let (key, value) = pair?;
                if !key.starts_with(prefix) {
                    break;
                }
                pairs.push((Bytes::copy_from_slice(&key), Bytes::copy_from_slice(&value)));
            }
            Ok(pairs)
        })
    }

    fn write(&self, batch: &WriteSet, tip: (&[u8], &[u8])) -> Result<(), Rejection> {
        let written = self.read(|tree| {
            let mut stored = sled::Batch::default();
            for (key, value) in batch {
                match value {
                    Some(value) => stored.insert(&key[..], &value[..]),
                    None => stored.remove(&key[..]),
                }
            }
            stored.insert(tip.0, tip.1);
            tree.apply_batch(stored)?;
            tree.flush().map(drop)
        });
        if written.is_err() {
            self.reopen();
        }
        written
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::sync::mpsc;

    /// Names, bytes and times of change of all files.
    fn files(directory: &Path) -> Vec<(PathBuf, Vec<u8>, std::time::SystemTime)> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(directory).unwrap() {
            let entry = entry.unwrap();
            let bytes = if entry.path().is_dir() { Vec::new() } else { std::fs::read(entry.path()).unwrap() };
            found.push((entry.path(), bytes, entry.metadata().unwrap().modified().unwrap()));
        }
        found.sort();
        found
    }

    #[test]
    fn a_copy_is_read_and_nothing_is_written_into_what_it_is_a_copy_of() {
        let place = tempfile::tempdir().unwrap();
        let batch = WriteSet::from_iter([(Bytes::from_static(b"key"), Some(Bytes::from_static(b"value")))]);
        SledStore::open(place.path()).unwrap().write(&batch, (b"tip", b"1")).unwrap();
        let before = files(place.path());
        let copy = SledStore::open_copy(place.path()).unwrap();
        assert_eq!(copy.get(b"key").unwrap().as_deref(), Some(&b"value"[..]));
        let directory = copy.directory.clone();
        copy.write(&batch, (b"tip", b"2")).unwrap();
        assert!(directory.exists() && !directory.starts_with(place.path()));
        drop(copy);
        assert!(!directory.exists(), "it goes away with its value");
        assert_eq!(files(place.path()), before);
    }

    #[test]
    fn a_store_that_is_just_being_closed_is_waited_for() {
        let place = tempfile::tempdir().unwrap();
        let first = SledStore::open(place.path()).unwrap();
        // While another has the lock, sled says what we wait for.
        let refused = config(place.path()).open().unwrap_err();
        assert!(matches!(&refused, sled::Error::Io(error) if error.to_string().starts_with(LOCKED)), "{refused}");
        let (opening, opens) = mpsc::channel();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                opens.recv().unwrap();
                drop(first);
            });
            opening.send(()).unwrap();
            SledStore::open(place.path()).unwrap();
        });
    }
}
