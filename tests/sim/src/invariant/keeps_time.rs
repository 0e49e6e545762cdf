//! Block time keeps to the clocks of a majority. No committed block is further ahead of them than the network allows, or
//! than blocks before it were. A clock counts by the latest time that it has shown.

use super::{Check, Violation};
use ledger_raft::TIME_AHEAD_MAX;
use std::cmp::Reverse;
use std::collections::BTreeSet;

const NAME: &str = "block time keeps to the clocks";

/// Block time as it was last further ahead than before, and when that was.
#[derive(Default)]
pub struct BlockTimeKeepsToTheClocks {
    anchor: (u64, u64),
}

impl BlockTimeKeepsToTheClocks {
    /// A block was executed for the first time, at a virtual time. `latest` gives the latest time that the clock of a voter
    /// has shown so far. The voters of each of the sets may have decided.
    ///
    /// # Errors
    /// No majority can have acknowledged it.
    pub fn executed(
        &mut self,
        now: u64,
        (height, time): (u64, u64),
        sets: &[&BTreeSet<u64>],
        latest: impl Fn(u64) -> u64,
    ) -> Check {
        let of_majority = |voters: &&BTreeSet<u64>| {
            let mut clocks: Vec<u64> = voters.iter().map(|voter| latest(*voter)).collect();
            clocks.sort_unstable_by_key(|clock| Reverse(*clock));
            clocks.get(clocks.len() / 2).copied().unwrap_or(0)
        };
        let clock = sets.iter().map(of_majority).max().unwrap_or(0);
        let going_on = self.anchor.0 + now.saturating_sub(self.anchor.1);
        let most = going_on.max(clock + TIME_AHEAD_MAX);
        if time > going_on {
            self.anchor = (time, now);
        }
        match time > most {
            true => Err(Violation::new(NAME, format!("block {height} is {} us further ahead", time - most))),
            false => Ok(()),
        }
    }
}
