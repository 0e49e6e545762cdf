//! A world state in memory: for tests, simulation and offline verification.

use crate::state::{StateRead, WriteSet};
use bytes::Bytes;
use ledger_base::rejection::Rejection;
use std::collections::BTreeMap;
use std::ops::Bound;
use std::sync::{PoisonError, RwLock};

/// Keys and values in memory.
#[derive(Debug, Default)]
pub struct MemoryState {
    pairs: RwLock<BTreeMap<Bytes, Bytes>>,
}

impl MemoryState {
    /// Applies sorted writes.
    pub fn apply(&self, writes: &WriteSet) {
        let mut pairs = self.pairs.write().unwrap_or_else(PoisonError::into_inner);
        for (key, value) in writes {
            match value {
                Some(value) => pairs.insert(key.clone(), value.clone()),
                None => pairs.remove(key),
            };
        }
    }
}

impl StateRead for MemoryState {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        Ok(self.pairs.read().unwrap_or_else(PoisonError::into_inner).get(key).cloned())
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        let pairs = self.pairs.read().unwrap_or_else(PoisonError::into_inner);
        let start = match after {
            Some(after) => Bound::Excluded(after),
            None => Bound::Included(prefix),
        };
        Ok(pairs
            .range::<[u8], _>((start, Bound::Unbounded))
            .take_while(|(key, _)| key.starts_with(prefix))
            .take(limit)
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect())
    }
}

impl super::Store for MemoryState {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        StateRead::get(self, key)
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        StateRead::range(self, prefix, after, limit)
    }

    fn write(&self, batch: &WriteSet, (key, value): (&[u8], &[u8])) -> Result<(), Rejection> {
        self.apply(batch);
        self.apply(&WriteSet::from([(Bytes::copy_from_slice(key), Some(Bytes::copy_from_slice(value)))]));
        Ok(())
    }
}
