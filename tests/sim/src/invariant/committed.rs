//! Committed is immutable (Raft §5.3, state machine safety): every node executes the same entry at an index, in order,
//! each once. A log that is opened again still has the entries that were committed in it.

use super::{Check, Violation};
use ledger_storage::block_store::BlockStore;
use ledger_storage::entry::Entry;

const NAME: &str = "committed is immutable";

/// Every entry that any node called committed.
#[derive(Default)]
pub struct CommittedIsImmutable {
    chosen: Vec<Entry>,
}

impl CommittedIsImmutable {
    /// A node says that this entry is committed.
    ///
    /// # Errors
    /// Another entry was, at this index.
    pub fn committed(&mut self, node: u64, entry: &Entry) -> Check {
        let at = entry.index as usize - 1;
        if at == self.chosen.len() {
            self.chosen.push(entry.clone());
        }
        match self.chosen.get(at) {
            Some(chosen) if chosen == entry => Ok(()),
            Some(chosen) => Err(Violation::new(
                NAME,
                format!(
                    "node {node} commits entry {} of term {}, and term {} was",
                    entry.index, entry.term, chosen.term
                ),
            )),
            None => Err(Violation::new(NAME, format!("node {node} commits entry {} after {}", entry.index, at))),
        }
    }

    /// A log was opened again.
    ///
    /// # Errors
    /// It calls something committed that is not what was committed.
    pub fn reopened(&self, node: u64, store: &BlockStore) -> Check {
        for index in store.first_index()..=store.hard_state().commit {
            let term = self.chosen.get(index as usize - 1).map(|entry| entry.term);
            if store.term(index) != term {
                return Err(Violation::new(
                    NAME,
                    format!(
                        "node {node} has entry {index} of term {:?} after a start, committed was {term:?}",
                        store.term(index)
                    ),
                ));
            }
        }
        Ok(())
    }

    /// The committed entries, from index 1.
    pub fn chosen(&self) -> &[Entry] {
        &self.chosen
    }
}
