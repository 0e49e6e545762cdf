//! The content of a snapshot: its items, and the state and results that are filled with them.

use super::items::{Item, Items};
use super::manifest::CHUNK_BYTES_MAX;
use super::{Snapshot, damaged};
use crate::results::ResultStore;
use crate::state::{State, Store};
use bytes::Bytes;
use ledger_base::rejection::Rejection;

impl Snapshot {
    /// Everything in it, in order.
    pub fn items(&self) -> Items<'_> {
        Items::new(self, false)
    }

    /// The pairs of the world state whose keys begin so, for example the organisations whose nodes may
    /// attest it. At most `limit`.
    ///
    /// # Errors
    /// `Code::Corrupt` if it is no snapshot up to there.
    pub fn pairs(&self, prefix: &[u8], limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        let mut found = Vec::new();
        for item in Items::new(self, true) {
            match item? {
                Item::Pair(key, value) if key.starts_with(prefix) && found.len() < limit => found.push((key, value)),
                Item::Pair(key, _) if key.as_ref() < prefix => {}
                _ => break,
            }
        }
        Ok(found)
    }

    /// Fills an empty world state and empty results, so that a ledger opened on them stands at this height. If it is
    /// interrupted, both are to be emptied and filled again; a state that was not filled to the end is refused when it
    /// is opened.
    ///
    /// # Errors
    /// `Code::BadFile` if they are not empty, `Code::Corrupt` if this is no snapshot; a fault of the disk.
    pub fn fill(&self, store: &dyn Store, results: &ResultStore) -> Result<(), Rejection> {
        let mut items = self.items();
        let mut first = None;
        let pairs = std::iter::from_fn(|| match items.next()? {
            Ok(Item::Pair(key, value)) => Some(Ok((key, value))),
            Ok(Item::Result(height, result)) => {
                first = Some((height, result));
                None
            }
            Err(fault) => Some(Err(fault)),
        });
        let filled = State::fill(store, pairs)?;
        let (height, result) = first.ok_or_else(|| damaged(self.name(), "it has no results"))?;
        results.begin(height)?;
        results.push_whole(height, result)?;
        for item in items {
            if let Item::Result(height, result) = item? {
                results.push_whole(height, result)?;
                if results.is_durable() && results.pending_bytes() >= CHUNK_BYTES_MAX {
                    results.flush(height)?;
                }
            }
        }
        if results.is_durable() {
            results.flush(self.manifest().height)?;
        }
        filled.finish(&self.manifest().tip)
    }
}
