//! State agreement (design.md §7.2): the same state digest at the same height on every node.

use super::{Check, Executed, Violation};
use ledger::Outcome;
use ledger_base::hash::Hash;
use std::collections::BTreeMap;

const NAME: &str = "state agreement";

/// The one state at each height.
#[derive(Default)]
pub struct StateAgreement {
    digests: Vec<Hash>,
    /// The content of the snapshot of each height.
    snapshots: BTreeMap<u64, Hash>,
}

impl StateAgreement {
    /// A node has executed a block.
    ///
    /// # Errors
    /// Another node came to another state at this height.
    pub fn executed(&mut self, executed: &Executed<'_>) -> Check {
        let at = executed.outcome.header.height as usize - 1;
        if at == self.digests.len() {
            self.digests.push(executed.outcome.digest);
        }
        match self.digests.get(at) {
            Some(digest) if *digest == executed.outcome.digest => Ok(()),
            _ => Err(Violation::new(
                NAME,
                format!("after block {} the state of node {} is not that of the others", at + 1, executed.node),
            )),
        }
    }

    /// A node has a snapshot of a height.
    ///
    /// # Errors
    /// Another node's is another one.
    pub fn snapshot(&mut self, node: u64, height: u64, content: Hash) -> Check {
        match *self.snapshots.entry(height).or_insert(content) {
            known if known == content => Ok(()),
            _ => Err(Violation::new(NAME, format!("the snapshot of height {height} of node {node} is another"))),
        }
    }

    /// A node's report of a block, beyond the digest: texts of refusals, events.
    ///
    /// # Errors
    /// It says something else than the node that executed the block first.
    pub fn same(&self, node: u64, first: &Outcome, outcome: &Outcome) -> Check {
        if first == outcome {
            return Ok(());
        }
        let height = outcome.header.height;
        Err(Violation::new(NAME, format!("node {node} tells of block {height} what others do not")))
    }

    /// Two nodes at the same height hold the same keys and values.
    ///
    /// # Errors
    /// The first key in which they differ.
    pub fn compare(&self, one: (u64, &World), other: (u64, &World)) -> Check {
        let differs = one.1.iter().zip(other.1).find(|(a, b)| a != b);
        let key = match differs {
            Some(((key, _), _)) => key,
            None if one.1.len() == other.1.len() => return Ok(()),
            None => match one.1.get(other.1.len()).or_else(|| other.1.get(one.1.len())) {
                Some((key, _)) => key,
                None => return Ok(()),
            },
        };
        let what = format!("nodes {} and {} differ at key {:?}", one.0, other.0, String::from_utf8_lossy(key));
        Err(Violation::new(NAME, what))
    }
}

/// All keys and values of a node, in order.
type World = Vec<(bytes::Bytes, bytes::Bytes)>;
