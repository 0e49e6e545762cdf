//! Exactly once (design.md §7.1): however often a transaction is submitted, through whichever node, it is executed
//! once; a repetition changes nothing.

use super::{Check, Executed, Violation};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use std::collections::BTreeMap;

const NAME: &str = "exactly once";

/// Where each transaction was executed.
#[derive(Default)]
pub struct ExactlyOnce {
    executed: BTreeMap<Hash, (u64, usize)>,
}

impl ExactlyOnce {
    /// A block was executed for the first time.
    ///
    /// # Errors
    /// One of its transactions succeeded, and had been executed before.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        for (at, (id, result)) in executed.outcome.ids.iter().zip(&executed.outcome.results).enumerate() {
            if result.code() != Code::Ok {
                continue;
            }
            if let Some((first, _)) = self.executed.insert(*id, (height, at)) {
                return Err(Violation::new(
                    NAME,
                    format!("transaction {id} succeeded in block {height}, and had in block {first}"),
                ));
            }
        }
        Ok(())
    }

    /// Where a transaction succeeded.
    pub fn place(&self, id: &Hash) -> Option<(u64, usize)> {
        self.executed.get(id).copied()
    }
}
