//! Uncommitted writes, layered over the committed state.

use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound;
use std::sync::Arc;

/// Read access to the committed world state. Keys are full keys (chaincode, NUL, key).
pub trait StateRead: Send + Sync {
    /// The value of a key.
    ///
    /// # Errors
    /// [`Code::DiskFailed`] or [`Code::Corrupt`] if the store cannot answer; the node must stop then.
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection>;

    /// At most `limit` pairs whose keys start with `prefix` and are greater than `after`, in order of keys.
    ///
    /// # Errors
    /// As [`StateRead::get`].
    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection>;
}

/// Sorted writes: a value, or `None` for a deletion.
pub type WriteSet = BTreeMap<Bytes, Option<Bytes>>;

/// A stack of write sets over the committed state: the block at the bottom, above it the transaction, above it
/// one layer per nested call. A failed call drops its layer; a successful one merges into the one below.
pub struct Overlay {
    state: Arc<dyn StateRead>,
    layers: Vec<WriteSet>,
    fault: RefCell<Option<Rejection>>,
}

impl Overlay {
    /// An overlay with one empty layer.
    pub fn new(state: Arc<dyn StateRead>) -> Self {
        Self { state, layers: vec![WriteSet::new()], fault: RefCell::new(None) }
    }

    /// Opens a layer.
    pub fn begin(&mut self) {
        self.layers.push(WriteSet::new());
    }

    /// Merges the top layer into the one below it.
    pub fn commit(&mut self) {
        if self.layers.len() > 1
            && let Some(top) = self.layers.pop()
            && let Some(below) = self.layers.last_mut()
        {
            below.extend(top);
        }
    }

    /// Drops the top layer and all its writes.
    pub fn rollback(&mut self) {
        if self.layers.len() > 1 {
            self.layers.pop();
        }
    }

    /// How many layers are open; the bottom counts.
    pub fn depth(&self) -> usize {
        self.layers.len()
    }

    /// Says that what was read contradicts itself: [`Overlay::finish`] gives this fault, and nothing computed here may be used.
    pub fn fail(&self, fault: Rejection) {
        self.fault.borrow_mut().get_or_insert(fault);
    }

    /// The value as the top layer sees it. A store that cannot answer leaves a fault (see [`Overlay::finish`]).
    pub fn get(&self, key: &[u8]) -> Option<Bytes> {
        for layer in self.layers.iter().rev() {
            if let Some(written) = layer.get(key) {
                return written.clone();
            }
        }
        match self.state.get(key) {
            Ok(value) => value,
            Err(fault) => {
                self.fault.borrow_mut().get_or_insert(fault);
                None
            }
        }
    }

    /// Writes into the top layer.
    pub fn write(&mut self, key: Bytes, value: Option<Bytes>) {
        if let Some(top) = self.layers.last_mut() {
            top.insert(key, value);
        }
    }

    /// At most `limit` pairs whose keys start with `prefix`, in order of keys, as the top layer sees them.
    pub fn range(&self, prefix: &[u8], limit: usize) -> Vec<(Bytes, Bytes)> {
        self.range_after(prefix, None, limit)
    }

    /// As [`Overlay::range`], of the keys that are greater than `after`.
    pub fn range_after(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Vec<(Bytes, Bytes)> {
        let below = |after: Option<&[u8]>, limit| self.state.range(prefix, after, limit);
        Self::first(self.layers.iter(), prefix, after, limit, below).unwrap_or_else(|fault| {
            self.fault.borrow_mut().get_or_insert(fault);
            Vec::new()
        })
    }

    /// At most `limit` pairs whose keys start with `prefix` and are greater than `after`, of write sets, the newest last,
    /// over what lies below them. Reads of each only what the answer needs: a chaincode asks for the first of many keys
    /// in every block.
    pub(crate) fn first<'a>(
        layers: impl Iterator<Item = &'a WriteSet>,
        prefix: &[u8],
        after: Option<&[u8]>,
        limit: usize,
        below: impl Fn(Option<&[u8]>, usize) -> Result<Vec<(Bytes, Bytes)>, Rejection>,
    ) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        let start = after.map_or(Bound::Included(prefix), Bound::Excluded);
        let within = |set: &'a WriteSet| {
            set.range::<[u8], _>((start, Bound::Unbounded)).take_while(|(key, _)| key.starts_with(prefix)).peekable()
        };
        let mut layers: Vec<_> = layers.map(within).collect();
        let (mut stored, mut last, mut wanted) = (VecDeque::new(), after.map(Bytes::copy_from_slice), limit);
        let mut found = Vec::new();
        while found.len() < limit {
            if stored.is_empty() && wanted > 0 {
                let pairs = below(last.as_deref(), wanted)?;
                // What was deleted above takes more: each time twice as much, until there is no more.
                wanted = if pairs.len() < wanted { 0 } else { wanted.saturating_mul(2) };
                last = pairs.last().map(|(key, _)| key.clone()).or(last);
                stored.extend(pairs);
            }
            let written = layers.iter_mut().filter_map(|layer| layer.peek().map(|(key, _)| *key)).min();
            let Some(key) = written.into_iter().chain(stored.front().map(|(key, _)| key)).min().cloned() else { break };
            let mut value = stored.pop_front_if(|(stored, _)| *stored == key).map(|(_, value)| value);
            for layer in &mut layers {
                if let Some((_, newer)) = layer.next_if(|(written, _)| **written == key) {
                    value.clone_from(newer);
                }
            }
            found.extend(value.map(|value| (key, value)));
        }
        Ok(found)
    }

    /// The writes to keys that start with `prefix`, in order of keys, as far as they are in the bottom layer: those of the
    /// transactions so far.
    pub fn written<'a>(&'a self, prefix: &'a [u8]) -> impl Iterator<Item = (&'a Bytes, &'a Option<Bytes>)> {
        let from: (Bound<&[u8]>, Bound<&[u8]>) = (Bound::Included(prefix), Bound::Unbounded);
        let bottom = self.layers.first().into_iter();
        bottom.flat_map(move |writes| writes.range::<[u8], _>(from)).take_while(move |(key, _)| key.starts_with(prefix))
    }

    /// The writes of the bottom layer.
    ///
    /// # Errors
    /// The fault of the store, if it could not answer a read in between: then nothing computed here may be used.
    pub fn finish(mut self) -> Result<WriteSet, Rejection> {
        match self.fault.into_inner() {
            Some(fault) => Err(fault),
            None if self.layers.len() == 1 => Ok(self.layers.pop().unwrap_or_default()),
            None => Err(Rejection::new(Code::Internal, format!("{} layers were left open", self.layers.len() - 1))),
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::cell::Cell;

    type Pairs = Vec<(Bytes, Bytes)>;

    fn key(number: u32) -> Bytes {
        format!("k{number:04}").into()
    }

    fn below(pairs: &Pairs, after: Option<&[u8]>, limit: usize) -> Pairs {
        let later = |pair: &&(Bytes, Bytes)| pair.0.starts_with(b"k") && after.is_none_or(|after| &pair.0[..] > after);
        pairs.iter().filter(later).take(limit).cloned().collect()
    }

    #[test]
    fn newer_writes_hide_older_ones_whatever_the_limit() {
        let stored: Pairs = (0..40).map(|number| (key(number), "stored".into())).collect();
        let older: WriteSet = (0..40).step_by(2).map(|number| (key(number), Some("older".into()))).collect();
        let mut newer: WriteSet = (0..40).step_by(3).map(|number| (key(number), None)).collect();
        newer.insert(key(0), Some("newer".into()));
        newer.insert("other".into(), Some("of another prefix".into()));
        let mut all: BTreeMap<Bytes, Option<Bytes>> =
            stored.iter().map(|(key, value)| (key.clone(), Some(value.clone()))).collect();
        all.extend(older.clone());
        all.extend(newer.clone());
        for after in [None, Some(key(6)), Some(key(7)), Some(key(99))] {
            let later = |key: &Bytes| key.starts_with(b"k") && after.as_ref().is_none_or(|after| key > after);
            let wanted: Pairs =
                all.iter().filter(|(key, _)| later(key)).filter_map(|(k, v)| Some((k.clone(), v.clone()?))).collect();
            for limit in 0..50 {
                let after = after.as_deref();
                let read = |after: Option<&[u8]>, limit| Ok(below(&stored, after, limit));
                let found = Overlay::first([&older, &newer].into_iter(), b"k", after, limit, read).unwrap();
                assert_eq!(found, wanted.iter().take(limit).cloned().collect::<Pairs>(), "limit {limit}");
            }
        }
    }

    #[test]
    fn the_first_of_many_keys_costs_no_more_than_one_of_few() {
        let stored: Pairs = (0..1000).map(|number| (key(number), Bytes::new())).collect();
        let written: WriteSet = (1..1000).map(|number| (key(number), None)).collect();
        let read = Cell::new(0);
        let count = |after: Option<&[u8]>, limit| {
            read.set(read.get() + limit);
            Ok(below(&stored, after, limit))
        };
        let found = Overlay::first([&written].into_iter(), b"k", None, 1, count).unwrap();
        assert_eq!((found, read.get()), (vec![(key(0), Bytes::new())], 1));
    }
}
