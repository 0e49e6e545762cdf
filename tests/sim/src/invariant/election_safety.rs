//! Election safety (Raft §5.2): at most one leader can be elected in a given term, because every voter votes at most
//! once in it, whatever happens to it in between. Nobody follows a node that was not elected, whatever it claims.

use super::{Check, Violation};
use std::collections::BTreeMap;

const NAME: &str = "election safety";
const UNELECTED: &str = "only elected leaders are followed";

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

    /// A node takes another one for the leader of a term.
    ///
    /// # Errors
    /// That one was not elected.
    pub fn follows(&mut self, node: u64, term: u64, leader: u64) -> Check {
        match self.leaders.get(&term) {
            Some(elected) if *elected == leader => Ok(()),
            elected => Err(Violation::new(
                UNELECTED,
                format!("node {node} follows node {leader} in term {term}, and {elected:?} was elected"),
            )),
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

    /// The leader of a term.
    pub fn leader_of(&self, term: u64) -> Option<u64> {
        self.leaders.get(&term).copied()
    }

    /// How many leaders there were.
    pub fn elections(&self) -> u64 {
        self.leaders.len() as u64
    }
}
