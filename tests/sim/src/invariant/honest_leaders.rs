//! No honest leader is deposed: whatever its disk, its clock and its links do, no more voters than one organisation has complain about
//! it in a term (decision 164).

use super::Violation;
use std::collections::{BTreeMap, BTreeSet};

const NAME: &str = "no honest leader is deposed";

/// The voters that have complained about the leader of each term.
#[derive(Default)]
pub struct HonestLeadersStay {
    complaints: BTreeMap<u64, BTreeSet<u64>>,
}

impl HonestLeadersStay {
    /// A voter complains. `largest` is how many voters the largest organisation has. Answers whether that is enough to depose the
    /// leader.
    ///
    /// # Errors
    /// It is, and the leader is honest.
    pub fn complains(
        &mut self,
        node: u64,
        (term, leader): (u64, u64),
        largest: usize,
        is_honest: bool,
    ) -> Result<bool, Violation> {
        let by = self.complaints.entry(term).or_default();
        let is_new = by.insert(node);
        let is_enough = by.len() > largest;
        match is_enough && is_honest {
            true => Err(Violation::new(NAME, format!("nodes {by:?} complain about node {leader} in term {term}"))),
            false => Ok(is_new && by.len() == largest + 1),
        }
    }
}
