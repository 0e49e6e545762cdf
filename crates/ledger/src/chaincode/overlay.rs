//! Uncommitted writes, layered over the committed state.

use crate::code::Code;
use crate::rejection::Rejection;
use bytes::Bytes;
use std::cell::RefCell;
use std::collections::BTreeMap;
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
        let mut written = BTreeMap::new();
        for layer in &self.layers {
            for (key, value) in
                layer.range(Bytes::copy_from_slice(prefix)..).take_while(|(key, _)| key.starts_with(prefix))
            {
                written.insert(key.clone(), value.clone());
            }
        }
        let deleted = written.values().filter(|value| value.is_none()).count();
        let committed = match self.state.range(prefix, None, limit.saturating_add(deleted)) {
            Ok(pairs) => pairs,
            Err(fault) => {
                self.fault.borrow_mut().get_or_insert(fault);
                Vec::new()
            }
        };
        let mut merged: BTreeMap<Bytes, Option<Bytes>> =
            committed.into_iter().map(|(key, value)| (key, Some(value))).collect();
        merged.extend(written);
        merged.into_iter().filter_map(|(key, value)| Some((key, value?))).take(limit).collect()
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
