//! Log matching (Raft §5.3): if two logs contain an entry with the same index and term, then the logs are identical in
//! all entries up through it.
//!
//! By induction it is enough that wherever an index and a term meet, the content and the term of the entry before are
//! always the same.

use super::{Check, Violation};
use ledger_base::hash::Hash;
use ledger_storage::block_store::BlockStore;
use ledger_storage::entry::Entry;
use std::collections::BTreeMap;

const NAME: &str = "log matching";

/// The entries that were seen at each place of any log.
#[derive(Default)]
pub struct LogMatching {
    /// By index and term: the content, and the term before.
    seen: BTreeMap<(u64, u64), (Hash, u64)>,
    /// The terms of each node's log as of the last look, from index 1.
    known: BTreeMap<u64, Vec<u64>>,
}

impl LogMatching {
    /// Looks at what is new in a node's log.
    ///
    /// # Errors
    /// It contradicts what was seen in a log before.
    pub fn look(&mut self, node: u64, store: &BlockStore) -> Check {
        let known = self.known.entry(node).or_default();
        let last = store.last_index();
        known.truncate(last as usize);
        while let Some(term) = known.last() {
            if store.term(known.len() as u64) == Some(*term) {
                break;
            }
            known.pop();
        }
        let from = (known.len() as u64 + 1).max(store.first_index());
        if (known.len() as u64) + 1 < from {
            // A log that begins after a snapshot knows the term of the entry before its first.
            known.resize(from as usize - 2, 0);
            known.push(store.term(from - 1).unwrap_or(0));
        }
        let entries = store
            .entries(from..last + 1, usize::MAX)
            .map_err(|error| Violation::new(NAME, format!("node {node} cannot read its own log: {error}")))?;
        for entry in entries {
            let before = known.last().copied().unwrap_or(0);
            known.push(entry.term);
            let content = content(&entry);
            let seen = *self.seen.entry((entry.index, entry.term)).or_insert((content, before));
            if seen != (content, before) {
                return Err(Violation::new(
                    NAME,
                    format!("entry {} of term {} of node {node} is not what it is elsewhere", entry.index, entry.term),
                ));
            }
        }
        Ok(())
    }

    /// A node lost its log, or takes another one's place.
    pub fn forget(&mut self, node: u64) {
        self.known.remove(&node);
    }
}

fn content(entry: &Entry) -> Hash {
    Hash::of(&[&[entry.kind.code()], &entry.data])
}
