//! Snapshots are attested: nobody goes on from a snapshot unless nodes of two organisations have said on the ledger that
//! they have made the same (docs/reliability.md).

use super::{Check, Executed, Violation};
use ledger_base::hash::Hash;
use ledger_replica::witness::seen;
use std::collections::{BTreeMap, BTreeSet};

const NAME: &str = "snapshots are attested";

/// The organisations that attest a snapshot, by height and content.
#[derive(Default)]
pub struct SnapshotsAreAttested {
    by: BTreeMap<(u64, Hash), BTreeSet<String>>,
}

impl SnapshotsAreAttested {
    /// A block was executed for the first time.
    pub fn executed(&mut self, executed: &Executed<'_>) {
        for said in seen(executed.outcome).0 {
            if let (Some(content), Some((organisation, _))) = (said.attest.content, said.by.split_once('/')) {
                self.by.entry((said.attest.height, content)).or_default().insert(organisation.to_owned());
            }
        }
    }

    /// A node goes on from a snapshot.
    ///
    /// # Errors
    /// Too few attest it.
    pub fn installed(&self, node: u64, height: u64, content: Hash) -> Check {
        let by = self.by.get(&(height, content)).cloned().unwrap_or_default();
        match by.len() {
            0 | 1 => {
                Err(Violation::new(NAME, format!("node {node} takes the one of height {height}, attested by {by:?}")))
            }
            _ => Ok(()),
        }
    }
}
