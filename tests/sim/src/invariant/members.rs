//! Members follow the ledger: whoever gets a vote was given it by transactions, and who was removed loses it.

use super::{Check, Violation};
use ledger::members::Membership;
use ledger::msp::{NodeRecord, NodeRole};
use std::collections::{BTreeMap, BTreeSet};

const NAME: &str = "members follow the ledger";

/// The roles that the ledger ever gave to each node.
#[derive(Default)]
pub struct MembersFollowTheLedger {
    given: BTreeMap<u64, BTreeSet<NodeRole>>,
}

impl MembersFollowTheLedger {
    /// A block was executed for the first time: `before` and `after` are the members in fact, `records` what the ledger
    /// wants after it.
    ///
    /// # Errors
    /// A node votes or follows that the ledger never let in.
    pub fn executed(&mut self, before: &Membership, after: &Membership, records: &[NodeRecord]) -> Check {
        for record in records {
            self.given.entry(record.id).or_default().insert(record.role);
        }
        let had = |node: &u64, role| self.given.get(node).is_some_and(|given| given.contains(&role));
        let voters = after.voters.difference(&before.voters);
        if let Some(node) = voters.into_iter().find(|node| !had(node, NodeRole::Voter)) {
            return Err(Violation::new(NAME, format!("node {node} votes, and no transaction gave it a vote")));
        }
        let new = after.nodes();
        match new.difference(&before.nodes()).find(|node| !self.given.contains_key(node)) {
            Some(node) => Err(Violation::new(NAME, format!("node {node} is a member, and never joined"))),
            None => Ok(()),
        }
    }

    /// Nothing goes wrong any more, and the ledger has wanted the same for long.
    ///
    /// # Errors
    /// The members in fact are others.
    pub fn at_rest(&self, members: &Membership, records: &[NodeRecord]) -> Check {
        let (voters, learners) = ledger::msp::desired(records);
        if members.voters == voters && members.learners == learners && !members.is_joint() {
            return Ok(());
        }
        let what = format!("the ledger wants voters {voters:?} and learners {learners:?}, and there are {members:?}");
        Err(Violation::new(NAME, what))
    }
}
