//! The world state: the keys and values that executing all blocks leaves, and indexes over the chain.
//!
//! Blocks are the truth; everything here can be computed from them again. So a block is committed in memory and
//! written to the store later, many blocks in one batch together with the [`Tip`] that they lead to: a hot key that
//! changes a hundred times a second is written once. After a crash the blocks behind the stored tip are executed
//! again; on any doubt about the store it is thrown away and everything is.

mod memory;
mod store;

pub use memory::MemoryState;
pub use store::{SledStore, Store};

use crate::Hash;
use crate::chaincode::{StateRead, WriteSet};
use crate::code::Code;
use crate::rejection::Rejection;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

/// Where the execution of the chain stands: the savepoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tip {
    /// Height of the last executed block.
    pub height: u64,
    /// Its term.
    pub term: u64,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// Hash of its header; of the genesis at height 0.
    pub hash: Hash,
    /// State digest after it.
    pub digest: Hash,
}

/// Keys that belong to no chaincode start with a NUL, which no chaincode's name does.
const TIP_KEY: &[u8] = b"\0tip";

impl Tip {
    fn to_bytes(&self) -> Bytes {
        let mut bytes = Vec::with_capacity(88);
        for number in [self.height, self.term, self.time] {
            bytes.extend_from_slice(&number.to_be_bytes());
        }
        bytes.extend_from_slice(&self.hash.0);
        bytes.extend_from_slice(&self.digest.0);
        bytes.into()
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let number = |at: usize| Some(u64::from_be_bytes(bytes.get(at..at + 8)?.try_into().ok()?));
        let hash = |at: usize| Hash::from_slice(bytes.get(at..at + 32)?);
        (bytes.len() == 88).then_some(())?;
        Some(Self { height: number(0)?, term: number(8)?, time: number(16)?, hash: hash(24)?, digest: hash(56)? })
    }
}

/// The key under which the result of the block at a height is kept.
pub(crate) fn result_key(height: u64) -> Bytes {
    [b"\0b", &height.to_be_bytes()[..]].concat().into()
}

/// The key under which the place of a transaction is kept.
pub(crate) fn transaction_key(id: &Hash) -> Bytes {
    [b"\0t", &id.0[..]].concat().into()
}

/// The world state of a node: recent writes in memory over a [`Store`].
pub struct State {
    store: Box<dyn Store>,
    recent: RwLock<Recent>,
    /// One flush at a time.
    flushing: Mutex<()>,
}

struct Recent {
    /// Writes since the last flush began.
    dirty: WriteSet,
    /// Bytes in `dirty`, for [`State::dirty_bytes`].
    bytes: usize,
    /// Writes that a flush is just storing.
    in_flight: Arc<WriteSet>,
    tip: Option<Tip>,
}

impl State {
    /// The state that the store holds.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if its tip cannot be read: rebuild it then.
    pub fn open(store: Box<dyn Store>) -> Result<Self, Rejection> {
        let tip = match store.get(TIP_KEY)? {
            None => None,
            Some(bytes) => Some(Tip::from_bytes(&bytes).ok_or_else(|| {
                Rejection::new(Code::Corrupt, "the savepoint of the world state cannot be read")
                    .found(format!("{} bytes", bytes.len()))
                    .next("delete the state directory; the node rebuilds it from the blocks")
            })?),
        };
        let recent = Recent { dirty: BTreeMap::new(), bytes: 0, in_flight: Arc::default(), tip };
        Ok(Self { store, recent: RwLock::new(recent), flushing: Mutex::new(()) })
    }

    /// Where execution stands; nothing before the genesis was executed.
    pub fn tip(&self) -> Option<Tip> {
        self.recent.read().unwrap_or_else(PoisonError::into_inner).tip.clone()
    }

    /// Makes the writes of a block visible, all at once.
    pub fn commit(&self, writes: WriteSet, tip: Tip) {
        let mut recent = self.recent.write().unwrap_or_else(PoisonError::into_inner);
        for (key, value) in writes {
            recent.bytes += key.len() + value.as_ref().map_or(0, Bytes::len) + 64;
            recent.dirty.insert(key, value);
        }
        recent.tip = Some(tip);
    }

    /// Roughly how many bytes wait for a flush.
    pub fn dirty_bytes(&self) -> usize {
        self.recent.read().unwrap_or_else(PoisonError::into_inner).bytes
    }

    /// Stores everything committed so far and waits for the disk. Runs beside commits and reads.
    ///
    /// # Errors
    /// [`Code::DiskFull`], [`Code::DiskFailed`]: nothing is lost, the blocks have it; the writes stay in memory.
    pub fn flush(&self) -> Result<(), Rejection> {
        let _one = self.flushing.lock().unwrap_or_else(PoisonError::into_inner);
        let (batch, tip) = {
            let mut recent = self.recent.write().unwrap_or_else(PoisonError::into_inner);
            let Some(tip) = recent.tip.clone() else { return Ok(()) };
            if recent.dirty.is_empty() && recent.in_flight.is_empty() {
                return Ok(());
            }
            // What a failed flush left behind goes first; newer writes win.
            let mut batch = WriteSet::clone(&recent.in_flight);
            batch.append(&mut recent.dirty);
            recent.in_flight = Arc::new(batch);
            recent.bytes = 0;
            (Arc::clone(&recent.in_flight), tip)
        };
        self.store.write(&batch, (TIP_KEY, &tip.to_bytes()))?;
        self.recent.write().unwrap_or_else(PoisonError::into_inner).in_flight = Arc::default();
        Ok(())
    }

    /// Everything of the world state in order of keys, for comparing two nodes or a snapshot: chaincode keys only.
    ///
    /// # Errors
    /// As [`StateRead::get`].
    pub fn world(&self, after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        self.range(b"", Some(after.unwrap_or(&[0, 0xff])), limit)
    }
}

impl StateRead for State {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        // The lock is held over the store's read: between the two a flush must not complete.
        let recent = self.recent.read().unwrap_or_else(PoisonError::into_inner);
        match recent.dirty.get(key).or_else(|| recent.in_flight.get(key)) {
            Some(written) => Ok(written.clone()),
            None => self.store.get(key),
        }
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        let recent = self.recent.read().unwrap_or_else(PoisonError::into_inner);
        let start = match after {
            Some(after) => std::ops::Bound::Excluded(after),
            None => std::ops::Bound::Included(prefix),
        };
        let mut written: BTreeMap<&Bytes, &Option<Bytes>> = BTreeMap::new();
        for layer in [&*recent.in_flight, &recent.dirty] {
            let range = layer.range::<[u8], _>((start, std::ops::Bound::Unbounded));
            written.extend(range.take_while(|(key, _)| key.starts_with(prefix)));
        }
        let deleted = written.values().filter(|value| value.is_none()).count();
        let stored = self.store.range(prefix, after, limit.saturating_add(deleted))?;
        let mut merged: BTreeMap<Bytes, Option<Bytes>> = stored.into_iter().map(|(k, v)| (k, Some(v))).collect();
        merged.extend(written.into_iter().map(|(key, value)| (key.clone(), value.clone())));
        Ok(merged.into_iter().filter_map(|(key, value)| Some((key, value?))).take(limit).collect())
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn tip(height: u64) -> Tip {
        Tip { height, term: 1, time: height * 10, hash: Hash::of(&[&height.to_be_bytes()]), digest: Hash::ZERO }
    }

    fn write(pairs: &[(&'static [u8], Option<&'static [u8]>)]) -> WriteSet {
        pairs.iter().map(|(k, v)| (Bytes::from_static(k), v.map(Bytes::from_static))).collect()
    }

    fn check(state: &State) {
        assert_eq!(state.get(b"a").unwrap(), None, "deleted");
        assert_eq!(state.get(b"b").unwrap().unwrap(), "2");
        let keys: Vec<_> = state.range(b"", None, 10).unwrap().into_iter().map(|(k, _)| k).collect();
        assert!(keys.ends_with(&[Bytes::from("b"), Bytes::from("c")]), "{keys:?}");
        assert_eq!(state.range(b"b", None, 10).unwrap().len(), 1);
        assert_eq!(state.range(b"", Some(b"b"), 10).unwrap().len(), 1);
    }

    #[test]
    fn reads_see_memory_over_flushes_over_the_store_and_survive_reopening() {
        let dir = tempfile::tempdir().unwrap();
        {
            let state = State::open(Box::new(SledStore::open(dir.path()).unwrap())).unwrap();
            assert_eq!(state.tip(), None);
            state.commit(write(&[(b"a", Some(b"1")), (b"b", Some(b"1")), (b"c", Some(b"3"))]), tip(1));
            state.flush().unwrap();
            state.commit(write(&[(b"a", None), (b"b", Some(b"2"))]), tip(2));
            check(&state);
            state.flush().unwrap();
            check(&state);
            state.commit(write(&[(b"d", Some(b"lost with the crash"))]), tip(3));
        }
        let state = State::open(Box::new(SledStore::open(dir.path()).unwrap())).unwrap();
        assert_eq!(state.tip(), Some(tip(2)), "tip and writes are stored in one batch");
        check(&state);
    }
}
