//! The clock of a ledger, from which a leader makes block time.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A clock that never goes back, not even behind the block time that the network has seen.
///
/// Block time does not go back, so a leader whose machine's clock was set back would let it stand still. No lease would
/// end, and every new transaction would come too late, until the machine's clock has caught up. The same holds for a
/// new leader whose machine is behind the old one's. This clock goes on from where block time was, by the machine's
/// monotonic time, and follows the machine's clock again once that is ahead. Clones share what they have observed.
///
/// The machine's clocks are told with each call: `wall` may be wrong and jump, `elapsed` grows steadily. All times are in
/// microseconds.
#[derive(Clone, Debug)]
pub struct Clock {
    /// Block time when `elapsed` was 0, or what newer block time makes of it. Never the machine's clock: one that was wrong
    /// at the start and is set right later must not stay wrong here.
    base: Arc<AtomicU64>,
}

impl Clock {
    /// The clock of a ledger with this newest block time, since the UNIX epoch. It never shows less.
    pub fn of(block_time: u64, elapsed: u64) -> Self {
        let clock = Self { base: Arc::default() };
        clock.observe(block_time, elapsed);
        clock
    }

    /// The time since the UNIX epoch, on a machine whose clocks show this.
    pub fn at(&self, wall: u64, elapsed: u64) -> u64 {
        wall.max(self.base.load(Ordering::Relaxed).saturating_add(elapsed))
    }

    /// Takes note of the newest block's time, which the clock is not behind from now on. Where the machine's clock is
    /// behind, the nodes go on from the same block and so agree, but for the time that it took to reach them.
    pub fn observe(&self, block_time: u64, elapsed: u64) {
        self.base.store(block_time.saturating_sub(elapsed), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_on_when_the_machines_clock_is_set_back_and_follows_it_ahead() {
        let clock = Clock::of(1_000, 0);
        assert_eq!(clock.at(1_500, 500), 1_500);
        assert_eq!(clock.at(200, 600), 1_600, "set back: it goes on");
        assert_eq!(clock.at(9_000, 700), 9_000, "set ahead: it follows");
    }

    #[test]
    fn a_machines_clock_that_was_wrong_at_the_start_and_is_set_right_leaves_nothing_behind() {
        let clock = Clock::of(1_000, 5);
        assert_eq!((clock.at(900_000, 10), clock.at(2_000, 20)), (900_000, 2_000));
    }

    #[test]
    fn it_is_never_behind_a_block_that_was_seen() {
        let clock = Clock::of(1_000, 0);
        clock.observe(50_000, 100);
        assert_eq!((clock.at(200, 100), clock.at(200, 150)), (50_000, 50_050));
        clock.clone().observe(50_020, 200);
        assert_eq!(clock.at(200, 250), 50_070, "the newest block counts: whoever made it was less ahead");
    }

    #[test]
    fn it_never_starts_behind_block_time() {
        assert_eq!(Clock::of(7_000, 300).at(20, 300), 7_000);
    }
}
