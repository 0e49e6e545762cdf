//! The world state: the keys and values that executing all blocks leaves.
//!
//! Blocks are the truth; everything here can be computed from them again. So a block is committed in memory and written
//! to the store later, many blocks in one batch together with the [`Tip`] that they lead to. A hot key that changes a
//! hundred times a second is written once. After a crash the blocks behind the stored tip are executed again; on any
//! doubt about the store it is thrown away and everything is. Answers of the store are remembered for a while, as long
//! as they are true: some keys, such as a robot's, are read by every block and hardly ever written.
//!
//! At heights where a snapshot is due the writes are cut into layers, which are stored one after the other. When the
//! last layer before the cut is stored, the store holds exactly the state at that height, while blocks go on above it.

mod cache;
mod memory;
mod overlay;
#[cfg(feature = "sled")]
mod scratch;
#[cfg(feature = "sled")]
mod sled_store;
mod store;

pub use memory::MemoryState;
pub use overlay::{Overlay, StateRead, WriteSet};
#[cfg(feature = "sled")]
pub use sled_store::SledStore;
pub use store::Store;

use self::cache::Cache;
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::invariant;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Pairs of a snapshot are stored in batches of about so many bytes.
const FILL_BYTES: usize = 1024 * 1024;

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
    /// States that this one is the next.
    fn check(&self, before: &Self) {
        let (height, after) = (self.height, before.height);
        invariant!(height == after + 1, "heights have no gap", "block {height} after {after}");
        let (term, earlier) = (self.term, before.term);
        invariant!(term >= earlier, "terms of blocks only grow", "term {term} after {earlier} at height {height}");
        let (time, earlier) = (self.time, before.time);
        invariant!(time >= earlier, "block time never goes back", "{time} after {earlier} at height {height}");
    }

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

/// In a store that is filled from a snapshot, until it is complete.
const INSTALLING_KEY: &[u8] = b"\0installing";

/// Chaincode keys come after this one.
const WORLD_BEGINS: &[u8] = &[0, 0xff];

/// Most layers in memory. When the store is slower than that, cuts are given up, as every layer makes reading slower.
const LAYERS_MAX: usize = 8;

/// The world state of a node: recent writes in memory over a [`Store`].
pub struct State {
    store: Box<dyn Store>,
    /// The values of some keys in the store. Changed only under a lock of `recent`.
    cache: Cache,
    recent: RwLock<Unstored>,
}

struct Unstored {
    /// Writes since the newest layer was closed.
    dirty: WriteSet,
    /// Bytes in `dirty`, for [`State::dirty_bytes`].
    bytes: usize,
    /// Closed layers, oldest first; the oldest may just be stored.
    layers: VecDeque<Arc<Layer>>,
    tip: Option<Tip>,
    /// The savepoint in the store.
    stored: Option<Tip>,
}

/// Writes that are stored together.
pub struct Layer {
    writes: WriteSet,
    bytes: usize,
    /// Where they lead.
    pub tip: Tip,
    /// Is a snapshot due at this height?
    cut: bool,
}

impl State {
    /// The state that the store holds.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if its tip cannot be read, or it was not filled to the end: rebuild it then.
    pub fn open(store: Box<dyn Store>) -> Result<Self, Rejection> {
        let tip = match store.get(TIP_KEY)? {
            None => None,
            Some(bytes) => Some(Tip::from_bytes(&bytes).ok_or_else(|| {
                Rejection::new(Code::Corrupt, "the savepoint of the world state cannot be read")
                    .found(format!("{} bytes", bytes.len()))
                    .next("delete the directory state/ while the node is stopped; it is rebuilt from the blocks")
            })?),
        };
        if store.get(INSTALLING_KEY)?.is_some() {
            return Err(Rejection::new(
                Code::Corrupt,
                "the installation of a snapshot into the world state is \
                                                      incomplete",
            )
            .next(
                "delete the directories state/ and results/ while the node is stopped; the snapshot is \
                       installed again",
            ));
        }
        if active(Mutation::ForgetAStop)
            && let Some(tip) = &tip
        {
            let stops = store.range(b"abac\0stopped/", None, usize::MAX)?;
            store.write(&stops.into_iter().map(|(key, _)| (key, None)).collect(), (TIP_KEY, &tip.to_bytes()))?;
        }
        let recent = Unstored { dirty: BTreeMap::new(), bytes: 0, layers: VecDeque::new(), stored: tip.clone(), tip };
        Ok(Self { store, cache: Cache::default(), recent: RwLock::new(recent) })
    }

    /// Fills an empty store with the pairs of a snapshot. Until that is [finished](Filled::finish) it cannot be opened.
    pub(crate) fn fill<'a>(
        store: &'a dyn Store,
        pairs: impl Iterator<Item = Result<(Bytes, Bytes), Rejection>>,
    ) -> Result<Filled<'a>, Rejection> {
        if !store.range(b"", None, 1)?.is_empty() {
            return Err(Rejection::new(Code::BadFile, "a snapshot can only be installed into an empty world state")
                .next("delete the directories state/ and results/ first"));
        }
        let (mut batch, mut bytes) = (WriteSet::new(), 0);
        for pair in pairs {
            let (key, value) = pair?;
            bytes += key.len() + value.len();
            batch.insert(key, Some(value));
            if bytes >= FILL_BYTES {
                store.write(&batch, (INSTALLING_KEY, b"a snapshot"))?;
                (batch, bytes) = (WriteSet::new(), 0);
            }
        }
        store.write(&batch, (INSTALLING_KEY, b"a snapshot"))?;
        Ok(Filled { store })
    }

    /// Where execution stands; nothing before the genesis was executed.
    pub fn tip(&self) -> Option<Tip> {
        self.read().tip.clone()
    }

    /// The savepoint of the store: execution goes on there after a crash.
    pub fn stored(&self) -> Option<Tip> {
        self.read().stored.clone()
    }

    /// Makes the writes of a block visible, all at once. With `cut` the store will once hold exactly the state after
    /// this block.
    pub fn commit(&self, writes: WriteSet, tip: Tip, cut: bool) {
        let mut recent = self.write();
        if let Some(before) = &recent.tip {
            tip.check(before);
        }
        for (key, value) in writes {
            recent.bytes += key.len() + value.as_ref().map_or(0, Bytes::len) + 64;
            recent.dirty.insert(key, value);
        }
        recent.tip = Some(tip);
        if cut {
            recent.close(true);
        }
    }

    /// Roughly how many bytes wait to be stored.
    pub fn dirty_bytes(&self) -> usize {
        let recent = self.read();
        recent.bytes + recent.layers.iter().map(|layer| layer.bytes).sum::<usize>()
    }

    /// The layer to be stored next, if execution stands above what is stored.
    pub fn next_layer(&self) -> Option<Arc<Layer>> {
        let mut recent = self.write();
        if recent.layers.is_empty() && recent.tip != recent.stored {
            recent.close(false);
        }
        recent.layers.front().map(Arc::clone)
    }

    /// Stores the oldest layer and waits for the disk. Runs beside commits and reads; one caller at a time.
    ///
    /// # Errors
    /// [`Code::DiskFull`], [`Code::DiskFailed`]: nothing is lost, the blocks have it; the writes stay in memory.
    pub fn store(&self, layer: &Arc<Layer>) -> Result<(), Rejection> {
        self.store.write(&layer.writes, (TIP_KEY, &layer.tip.to_bytes()))?;
        let mut recent = self.write();
        // Nobody reads the store meanwhile, so nothing of before comes in behind us.
        self.cache.forget(&layer.writes);
        recent.layers.pop_front_if(|oldest| Arc::ptr_eq(oldest, layer));
        recent.stored = Some(layer.tip.clone());
        Ok(())
    }

    /// Everything of the world state in order of keys, for comparing two nodes: chaincode keys only.
    ///
    /// # Errors
    /// As [`StateRead::get`].
    pub fn world(&self, after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        self.range(b"", Some(after.unwrap_or(WORLD_BEGINS)), limit)
    }

    /// The same of what the store holds, which is the state at [`State::stored`] as long as nobody stores.
    pub(crate) fn stored_world(&self, after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        self.store.range(b"", Some(after.unwrap_or(WORLD_BEGINS)), limit)
    }

    fn read(&self) -> RwLockReadGuard<'_, Unstored> {
        self.recent.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Unstored> {
        self.recent.write().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A store with all the pairs of a snapshot, which is not a state yet.
pub(crate) struct Filled<'a> {
    store: &'a dyn Store,
}

impl Filled<'_> {
    /// Makes it the state at this tip.
    pub(crate) fn finish(self, tip: &Tip) -> Result<(), Rejection> {
        self.store.write(&WriteSet::from([(Bytes::from_static(INSTALLING_KEY), None)]), (TIP_KEY, &tip.to_bytes()))
    }
}

impl Unstored {
    /// Closes the layer that blocks were written to.
    fn close(&mut self, cut: bool) {
        let Some(tip) = self.tip.clone() else { return };
        let (mut writes, mut bytes) = (std::mem::take(&mut self.dirty), std::mem::take(&mut self.bytes));
        // Not the oldest: it may just be stored.
        if self.layers.len() >= LAYERS_MAX
            && let Some(below) = self.layers.pop_back()
        {
            if below.cut {
                tracing::warn!(height = below.tip.height, "no snapshot: storing the world state takes too long");
            }
            let newer = std::mem::replace(&mut writes, below.writes.clone());
            writes.extend(newer);
            bytes += below.bytes;
        }
        self.layers.push_back(Arc::new(Layer { writes, bytes, tip, cut }));
    }

    /// The last write to a key, if there was one.
    fn get(&self, key: &[u8]) -> Option<&Option<Bytes>> {
        self.dirty.get(key).or_else(|| self.layers.iter().rev().find_map(|layer| layer.writes.get(key)))
    }
}

impl StateRead for State {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        // The lock is held over the store's read: between the two a flush must not complete.
        let recent = self.read();
        if let Some(written) = recent.get(key) {
            return Ok(written.clone());
        }
        if let Some(known) = self.cache.get(key) {
            return Ok(known);
        }
        let value = self.store.get(key)?;
        self.cache.keep(key, &value);
        Ok(value)
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        let recent = self.read();
        let layers = recent.layers.iter().map(|layer| &layer.writes).chain([&recent.dirty]);
        Overlay::first(layers, prefix, after, limit, |after, limit| self.store.range(prefix, after, limit))
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

    fn flush(state: &State) {
        while let Some(layer) = state.next_layer() {
            state.store(&layer).unwrap();
        }
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
            state.commit(write(&[(b"a", Some(b"1")), (b"b", Some(b"1")), (b"c", Some(b"3"))]), tip(1), false);
            flush(&state);
            state.commit(write(&[(b"a", None), (b"b", Some(b"2"))]), tip(2), false);
            check(&state);
            flush(&state);
            check(&state);
            state.commit(write(&[(b"d", Some(b"lost with the crash"))]), tip(3), false);
        }
        let state = State::open(Box::new(SledStore::open(dir.path()).unwrap())).unwrap();
        assert_eq!(state.tip(), Some(tip(2)), "tip and writes are stored in one batch");
        check(&state);
    }

    #[test]
    fn what_was_read_before_it_was_stored_anew_is_not_read_again() {
        let state = State::open(Box::<MemoryState>::default()).unwrap();
        for (height, value) in (1..).zip([&b"1"[..], b"2", b"3"]) {
            state.commit(write(&[(b"a", Some(value)), (b"b", None)]), tip(height), false);
            flush(&state);
            // From the store, then from the cache.
            for _ in 0..2 {
                assert_eq!(state.get(b"a").unwrap().unwrap(), value);
                assert_eq!(state.get(b"b").unwrap(), None);
            }
        }
        state.commit(write(&[(b"a", None), (b"b", Some(b"4"))]), tip(4), false);
        flush(&state);
        assert_eq!((state.get(b"a").unwrap(), state.get(b"b").unwrap()), (None, Some(Bytes::from("4"))));
    }

    #[test]
    fn at_a_cut_the_store_holds_exactly_the_state_of_that_height() {
        let state = State::open(Box::<MemoryState>::default()).unwrap();
        let value = |height: u64| Bytes::from(height.to_be_bytes().to_vec());
        for height in 1..=25 {
            let writes = WriteSet::from([(Bytes::from("a"), Some(value(height)))]);
            state.commit(writes, tip(height), height % 10 == 0);
        }
        assert_eq!(state.get(b"a").unwrap(), Some(value(25)));
        for stored in [10, 20, 25] {
            let layer = state.next_layer().unwrap();
            state.store(&layer).unwrap();
            assert_eq!(state.stored(), Some(tip(stored)));
            assert_eq!(state.stored_world(None, 10).unwrap(), [(Bytes::from("a"), value(stored))]);
            assert_eq!(state.get(b"a").unwrap(), Some(value(25)));
        }
        assert!(state.next_layer().is_none() && state.dirty_bytes() == 0);
    }

    #[test]
    fn a_slow_store_gives_up_cuts_and_loses_nothing() {
        let state = State::open(Box::<MemoryState>::default()).unwrap();
        let mut kept = BTreeMap::new();
        for height in 1..=100u64 {
            let (key, value) = (Bytes::from(format!("k{}", height % 13)), Bytes::from(height.to_string()));
            state.commit(WriteSet::from([(key.clone(), Some(value.clone()))]), tip(height), true);
            kept.insert(key, value);
        }
        assert!(state.read().layers.len() <= LAYERS_MAX);
        let wanted: Vec<_> = kept.into_iter().collect();
        assert_eq!(state.world(None, 100).unwrap(), wanted);
        flush(&state);
        assert_eq!(state.stored_world(None, 100).unwrap(), wanted);
        assert_eq!(state.stored(), Some(tip(100)));
    }
}
