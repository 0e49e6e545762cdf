//! Votes are informed: a node that has started gives no vote while those that it asked may still say that it has lost
//! blocks (docs/reliability.md).

use super::{Check, Violation};
use std::collections::BTreeMap;

const NAME: &str = "votes are informed";

/// The nodes whose question is not answered.
#[derive(Default)]
pub struct VotesAreInformed {
    open: BTreeMap<u64, u64>,
}

impl VotesAreInformed {
    /// A node asks the others, and so many have not answered.
    pub fn asks(&mut self, node: u64, silent: u64) {
        self.open.insert(node, silent);
    }

    /// One of them has answered.
    pub fn answered(&mut self, node: u64) {
        if let Some(silent) = self.open.get_mut(&node) {
            *silent = silent.saturating_sub(1);
        }
    }

    /// The time in which they could answer is over.
    pub fn closed(&mut self, node: u64) {
        self.open.remove(&node);
    }

    /// A node gives its vote to another.
    ///
    /// # Errors
    /// It is still to be told what it had.
    pub fn votes(&self, node: u64) -> Check {
        match self.open.get(&node) {
            None | Some(0) => Ok(()),
            Some(silent) => {
                Err(Violation::new(NAME, format!("node {node} votes while {silent} nodes have not answered it")))
            }
        }
    }
}
