//! Refused is final (gateway.proto, `SubmitResponse.height`). A node may refuse a transaction without a height, for a
//! reason that is the transaction's own. It was not executed then and never is, whichever node has a copy.

use super::{Check, Executed, Violation};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use std::collections::BTreeMap;

const NAME: &str = "refused is final";

/// The promises, and the executed transactions.
#[derive(Default)]
pub struct RefusedIsFinal {
    refused: BTreeMap<Hash, (u64, Code)>,
    executed: BTreeMap<Hash, u64>,
}

impl RefusedIsFinal {
    /// A client, which has not asked anybody else meanwhile, hears this code without a height.
    ///
    /// # Errors
    /// The transaction was executed before.
    pub fn refused(&mut self, node: u64, id: &Hash, code: Code) -> Check {
        if !code.is_final() {
            return Ok(());
        }
        self.refused.insert(*id, (node, code));
        match self.executed.get(id) {
            None => Ok(()),
            Some(height) => Err(Violation::new(
                NAME,
                format!("node {node} refuses {id} with {}, and it is executed in block {height}", code.name()),
            )),
        }
    }

    /// A block was executed for the first time.
    ///
    /// # Errors
    /// It has a verdict on a transaction that was refused.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let height = executed.outcome.header.height;
        for (id, result) in executed.outcome.ids.iter().zip(&executed.outcome.results) {
            if result.not_after.is_none() {
                continue;
            }
            self.executed.insert(*id, height);
            if let Some((node, code)) = self.refused.get(id) {
                let what = format!("block {height} executes {id}, which node {node} had refused with {}", code.name());
                return Err(Violation::new(NAME, what));
            }
        }
        Ok(())
    }
}
