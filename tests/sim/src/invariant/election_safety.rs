//! Election safety (Raft §5.2): at most one leader can be elected in a given term, because every voter votes at most
//! once in it, whatever happens to it in between.

use super::{Check, Violation};
use std::collections::BTreeMap;

const NAME: &str = "election safety";

/// The leader and the votes of every term.
#[derive(Default)]
pub struct ElectionSafety {
    leaders: BTreeMap<u64, u64>,
    votes: BTreeMap<(u64, u64), u64>,
}

impl ElectionSafety {
    /// A node takes itself for the leader of a term.
    ///
    /// # Errors
    /// Another one does, too.
    pub fn leads(&mut self, node: u64, term: u64) -> Check {
        match *self.leaders.entry(term).or_insert(node) {
            leader if leader == node => Ok(()),
            leader => Err(Violation::new(NAME, format!("nodes {leader} and {node} both lead term {term}"))),
        }
    }

    /// A node votes for a candidate.
    ///
    /// # Errors
    /// It has voted for another one in this term.
    pub fn votes(&mut self, node: u64, term: u64, candidate: u64) -> Check {
        match *self.votes.entry((node, term)).or_insert(candidate) {
            before if before == candidate => Ok(()),
            before => Err(Violation::new(
                NAME,
                format!("node {node} votes for {candidate} in term {term}, and had voted for {before}"),
            )),
        }
    }

    /// How many leaders there were.
    pub fn elections(&self) -> u64 {
        self.leaders.len() as u64
    }
}
