//! Chain agreement (design.md §7.2): the same block hash at the same height on every node.

use super::{Check, Executed, Violation};
use ledger_base::hash::Hash;

const NAME: &str = "chain agreement";

/// The one chain.
#[derive(Default)]
pub struct ChainAgreement {
    hashes: Vec<Hash>,
}

impl ChainAgreement {
    /// A node has executed a block.
    ///
    /// # Errors
    /// Another node has another block at this height, or it does not follow the one before.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let (node, header) = (executed.node, &executed.outcome.header);
        let at = header.height as usize - 1;
        if at > 0 && self.hashes.get(at - 1) != Some(&header.previous) {
            return Err(Violation::new(
                NAME,
                format!("block {} of node {node} does not follow block {}", header.height, at),
            ));
        }
        if at == self.hashes.len() {
            self.hashes.push(executed.outcome.hash);
        }
        match self.hashes.get(at) {
            Some(hash) if *hash == executed.outcome.hash => Ok(()),
            _ => Err(Violation::new(NAME, format!("block {} of node {node} is not that of the others", header.height))),
        }
    }
}
