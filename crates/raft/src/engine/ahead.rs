//! Blocks that are ordered and not executed yet, and the limit that a leader sets to them.
//!
//! Ordered transactions cannot be overtaken, so control waits behind them. How long depends on the machine and on what
//! else it does: the limit follows from how long blocks wait for their execution and take for it. A machine with
//! processors to spare gets large blocks, which cost less for each transaction; one that has none gets small ones.

use std::collections::VecDeque;

/// Longest time that the execution of a block may take, from its commit on, before less is allowed, microseconds.
const EXECUTION_US_MAX: u64 = 1000;
/// Least that is allowed in the end: a few dozen commands. Less would cost more for each than it saves.
const LEAST_BYTES: usize = 16 * 1024;

/// Blocks that a leader proposed, until they are executed.
#[derive(Debug)]
pub(super) struct Ahead {
    /// In order of index.
    blocks: VecDeque<Block>,
    /// Cost of what may be committed and not executed.
    allowed: usize,
    most: usize,
}

#[derive(Debug)]
struct Block {
    index: u64,
    cost: usize,
    /// When it was committed, microseconds.
    committed: Option<u64>,
}

impl Ahead {
    /// Allows so many bytes (see `EngineConfig::ahead_bytes`) as long as they are executed quickly.
    pub(super) fn new(most: usize) -> Self {
        Self { blocks: VecDeque::new(), allowed: most, most }
    }

    /// Another node leads.
    pub(super) fn clear(&mut self) {
        self.blocks.clear();
    }

    /// A block was proposed.
    pub(super) fn proposed(&mut self, index: u64, cost: usize) {
        self.blocks.push_back(Block { index, cost, committed: None });
    }

    /// Everything up to here was handed out to be executed.
    pub(super) fn committed(&mut self, until: u64, now: u64) {
        let blocks = self.blocks.iter_mut().take_while(|block| block.index <= until);
        blocks.for_each(|block| block.committed = block.committed.or(Some(now)));
    }

    /// Everything up to here was executed.
    pub(super) fn executed(&mut self, until: u64, now: u64) {
        while let Some(block) = self.blocks.pop_front_if(|block| block.index <= until) {
            let took = block.committed.map_or(0, |committed| now.saturating_sub(committed));
            // Down fast and up slowly, so that most blocks are in time.
            self.allowed = match took {
                EXECUTION_US_MAX.. => (self.allowed - self.allowed / 4).max(LEAST_BYTES.min(self.most)),
                _ => (self.allowed + self.allowed / 16 + 1).min(self.most),
            };
        }
    }

    /// The limit for the cost of the data of the next block. Blocks that wait for a majority, after `until`, do not
    /// count, or a distant one would be the limit. A block takes at most half of what is allowed: two keep disk and
    /// executor busy.
    pub(super) fn room(&self, until: u64) -> usize {
        let waiting: usize = self.blocks.iter().take_while(|block| block.index <= until).map(|block| block.cost).sum();
        self.allowed.saturating_sub(waiting).min(self.allowed.div_ceil(2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: usize = 64 * 1024;

    /// Blocks that take so long each, microseconds.
    fn execute(ahead: &mut Ahead, took: &[u64]) {
        for (index, took) in (1..).zip(took) {
            ahead.proposed(index, 100);
            ahead.committed(index, 1_000_000);
            ahead.executed(index, 1_000_000 + took);
        }
    }

    #[test]
    fn what_waits_for_execution_takes_room_and_what_waits_for_a_majority_does_not() {
        let mut ahead = Ahead::new(1000);
        assert_eq!(ahead.room(0), 500, "two blocks are to fit");
        (1..=3).for_each(|index| ahead.proposed(index, 400));
        assert_eq!(ahead.room(0), 500);
        assert_eq!(ahead.room(1), 500);
        assert_eq!(ahead.room(2), 200);
        assert_eq!(ahead.room(3), 0);
        ahead.committed(3, 5);
        ahead.executed(2, 6);
        assert_eq!(ahead.room(3), 500);
        ahead.clear();
        assert_eq!(ahead.room(9), 500);
    }

    #[test]
    fn slow_execution_allows_less_and_quick_execution_more_again() {
        let mut ahead = Ahead::new(MOST);
        execute(&mut ahead, &[EXECUTION_US_MAX]);
        assert!(ahead.room(0) < MOST / 2);
        execute(&mut ahead, &[10 * EXECUTION_US_MAX; 100]);
        assert_eq!(ahead.room(0), LEAST_BYTES / 2, "never less");
        execute(&mut ahead, &[EXECUTION_US_MAX - 1; 100]);
        assert_eq!(ahead.room(0), MOST / 2, "never more");
    }

    #[test]
    fn most_blocks_are_in_time_where_execution_takes_as_long_as_what_is_ahead() {
        // A machine that executes half of what is allowed at most in the time allowed.
        let mut ahead = Ahead::new(MOST);
        let mut late = 0;
        for index in 1..=1000 {
            let took = EXECUTION_US_MAX * ahead.room(0) as u64 * 4 / MOST as u64;
            late += u32::from(took >= EXECUTION_US_MAX);
            ahead.proposed(index, 100);
            ahead.committed(index, 0);
            ahead.executed(index, took);
        }
        assert!((100..300).contains(&late), "{late} of 1000");
    }
}
