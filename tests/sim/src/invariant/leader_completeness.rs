//! Leader completeness (Raft §5.4): if an entry is committed in a given term, then it is present in the logs of the
//! leaders of all higher-numbered terms.

use super::{Check, Violation};
use ledger_storage::block_store::BlockStore;

const NAME: &str = "leader completeness";

/// The committed entries, as far as any node has said so.
#[derive(Default)]
pub struct LeaderCompleteness {
    /// Term of the entry, and the lowest term in which a node was when it called it committed; from index 1. An entry
    /// was committed in that term or before it.
    committed: Vec<(u64, u64)>,
}

impl LeaderCompleteness {
    /// A node in a term says that an entry is committed.
    pub fn committed(&mut self, index: u64, entry_term: u64, node_term: u64) {
        if index == self.committed.len() as u64 + 1 {
            self.committed.push((entry_term, node_term));
        } else if let Some((_, term)) = self.committed.get_mut(index as usize - 1) {
            *term = node_term.min(*term);
        }
    }

    /// A node was elected.
    ///
    /// # Errors
    /// It lacks an entry that was committed in an earlier term.
    pub fn elected(&self, node: u64, term: u64, store: &BlockStore) -> Check {
        let needed = self.committed.iter().enumerate().filter(|(_, (_, known_in))| *known_in < term);
        for (at, (entry_term, _)) in needed {
            let index = at as u64 + 1;
            if index >= store.first_index() && store.term(index) != Some(*entry_term) {
                return Err(Violation::new(
                    NAME,
                    format!(
                        "node {node} leads term {term} without entry {index} of term {entry_term}, which was committed"
                    ),
                ));
            }
        }
        Ok(())
    }
}
