//! The clock of a ledger, from which a leader makes block time.

use ledger_raft::{ClockDoubt, TIME_AHEAD_MAX};
use std::sync::{Arc, Mutex, PoisonError};

/// Where block time is ahead of the machine's clock, this clock loses one part of so many: so it comes back.
const SLOWER: u64 = 16;

/// A clock that never goes back, not even behind the block time that the network has seen.
///
/// Block time does not go back, so a leader whose machine's clock was set back would let it stand still. No lease would
/// end, and every new transaction would come too late, until the machine's clock has caught up. The same holds for a
/// new leader whose machine is behind the old one's. This clock goes on from where block time was, by the machine's
/// monotonic time, and follows the machine's clock again once that is ahead. Meanwhile it runs a sixteenth slower, so that
/// every network comes back to the time of its machines. Clones share what they have observed.
///
/// The machine's clocks are told with each call: `wall` may be wrong and jump, `elapsed` grows steadily. All times are in
/// microseconds.
#[derive(Clone, Debug)]
pub struct Clock {
    anchor: Arc<Mutex<Anchor>>,
    /// The furthest that the machine's clock was ahead of the steady one, as far as it is believed.
    believed: Arc<Mutex<Option<i128>>>,
}

/// A block time, and when this node saw it. Never the machine's clock: one that was wrong at the start and is set right later
/// must not stay wrong here.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    block_time: u64,
    elapsed: u64,
}

impl Anchor {
    /// Block time as it goes on by itself.
    fn at(self, elapsed: u64) -> u64 {
        self.block_time.saturating_add(going_on(elapsed.saturating_sub(self.elapsed)))
    }
}

/// The progress of a clock that is ahead, in a time.
fn going_on(elapsed: u64) -> u64 {
    elapsed - elapsed / SLOWER
}

impl Clock {
    /// The clock of a ledger with this newest block time, since the UNIX epoch. It never shows less.
    pub fn of(block_time: u64, elapsed: u64) -> Self {
        Self { anchor: Arc::new(Mutex::new(Anchor { block_time, elapsed })), believed: Arc::default() }
    }

    /// The time since the UNIX epoch, on a machine whose clocks show this.
    pub fn at(&self, wall: u64, elapsed: u64) -> u64 {
        wall.max(self.anchor().at(elapsed))
    }

    /// The latest block time that a voter with this clock acknowledges: [`TIME_AHEAD_MAX`] ahead of its machine, or block time
    /// as it goes on where that is further. Nobody adds to the latter, so no leader gets further ahead block by block.
    pub fn accepts_until(&self, wall: u64, elapsed: u64) -> u64 {
        wall.saturating_add(TIME_AHEAD_MAX).max(self.anchor().at(elapsed))
    }

    /// Is the machine's clock to be doubted? It is when it jumps ahead by more than [`TIME_AHEAD_MAX`] against the steady clock.
    /// It is, too, from the start on while it is behind block time by more than that. A clock that is set back is not
    /// doubted: this one goes on.
    pub fn doubt(&self, wall: u64, elapsed: u64) -> Option<ClockDoubt> {
        let offset = i128::from(wall) - i128::from(elapsed);
        let behind = self.anchor().at(elapsed).saturating_sub(wall);
        let mut believed = self.believed.lock().unwrap_or_else(PoisonError::into_inner);
        let jump = believed.map(|believed| u64::try_from(offset - believed).unwrap_or(0));
        match jump {
            None if behind > TIME_AHEAD_MAX => return Some(ClockDoubt::Behind(behind)),
            Some(jump) if jump > TIME_AHEAD_MAX => return Some(ClockDoubt::Ahead(jump)),
            _ => *believed = (*believed).max(Some(offset)),
        }
        None
    }

    /// An operator says that the machine's clock is right, whatever block time is.
    pub fn confirm(&self, wall: u64, elapsed: u64) {
        let mut believed = self.believed.lock().unwrap_or_else(PoisonError::into_inner);
        *believed = Some(i128::from(wall) - i128::from(elapsed));
    }

    /// Takes note of a block's time, which the clock is not behind from now on. Where the machine's clock is behind, the
    /// nodes go on from the same block and so agree, but for the time that it took to reach them.
    pub fn observe(&self, block_time: u64, elapsed: u64) {
        let mut anchor = self.anchor.lock().unwrap_or_else(PoisonError::into_inner);
        if block_time > anchor.at(elapsed) {
            *anchor = Anchor { block_time, elapsed };
        }
    }

    fn anchor(&self) -> Anchor {
        *self.anchor.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_on_a_little_slower_when_the_machines_clock_is_set_back_and_follows_it_ahead() {
        let clock = Clock::of(1_000, 0);
        assert_eq!(clock.at(1_500, 480), 1_500);
        assert_eq!(clock.at(200, 1_600), 2_500, "set back: it goes on");
        assert_eq!(clock.at(9_000, 1_700), 9_000, "set ahead: it follows");
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
        assert_eq!((clock.at(200, 100), clock.at(200, 260)), (50_000, 50_150));
        clock.clone().observe(49_000, 260);
        assert_eq!(clock.at(200, 260), 50_150, "an older block turns nothing back");
    }

    #[test]
    fn blocks_that_are_executed_later_than_they_were_made_do_not_slow_it_down() {
        let clock = Clock::of(10_000_000, 0);
        // A leader makes each block by this clock; it is executed 2 ms later.
        for made in (0..10_000_000).step_by(4_000) {
            let block_time = clock.at(0, made);
            clock.observe(block_time, made + 2_000);
        }
        assert_eq!(clock.at(0, 16_000_000), 10_000_000 + 15_000_000);
    }

    #[test]
    fn it_comes_back_to_the_machines_clock() {
        let clock = Clock::of(2_000_000, 0);
        let wall = |elapsed| elapsed;
        assert_eq!(clock.at(wall(16_000_000), 16_000_000), 17_000_000);
        assert_eq!(clock.at(wall(32_000_000), 32_000_000), 32_000_000);
    }

    #[test]
    fn a_voter_acknowledges_two_seconds_ahead_of_its_machine_or_block_time_as_it_goes_on() {
        let clock = Clock::of(1_000_000, 0);
        assert_eq!(clock.accepts_until(5_000_000, 160), 5_000_000 + TIME_AHEAD_MAX);
        assert_eq!(Clock::of(50_000_000, 0).accepts_until(5_000_000, 160), 50_000_150);
    }

    #[test]
    fn blocks_at_the_bound_lead_no_voter_further_ahead() {
        let clock = Clock::of(0, 0);
        for elapsed in (0..1_000_000).step_by(1_000) {
            let latest = clock.accepts_until(elapsed, elapsed);
            assert!(latest <= elapsed + TIME_AHEAD_MAX);
            clock.observe(latest, elapsed);
        }
    }

    #[test]
    fn a_machines_clock_that_jumps_ahead_is_doubted_until_it_is_right_again() {
        let clock = Clock::of(0, 0);
        let jumps = [0, TIME_AHEAD_MAX, 60_000_000, 40_000_000, 3_000_000, 0];
        let doubts = jumps.map(|by| clock.doubt(1_000_000_000 + by, 0));
        let ahead = |by| Some(ClockDoubt::Ahead(by - TIME_AHEAD_MAX));
        assert_eq!(doubts, [None, None, ahead(60_000_000), ahead(40_000_000), None, None]);
        assert_eq!(clock.doubt(1_500_000_000, 500_000_000), None, "time goes on");
        assert_eq!(clock.clone().doubt(2_000_000_000, 500_000_000), Some(ClockDoubt::Ahead(497_000_000)));
        clock.confirm(2_000_000_000, 500_000_000);
        assert_eq!(clock.doubt(2_000_000_000, 500_000_000), None);
    }

    #[test]
    fn a_machines_clock_that_is_behind_block_time_from_the_start_is_doubted_until_it_is_set() {
        let clock = Clock::of(1_000_000_000, 0);
        assert_eq!(clock.doubt(5, 0), Some(ClockDoubt::Behind(999_999_995)));
        assert_eq!(clock.doubt(7_000_000_000, 16), None, "set at last");
        assert_eq!(clock.doubt(5, 32), None, "set back later");
        let confirmed = Clock::of(1_000_000_000, 0);
        confirmed.confirm(5, 0);
        assert_eq!((confirmed.doubt(5, 0), confirmed.at(5, 0)), (None, 1_000_000_000));
    }

    #[test]
    fn it_never_starts_behind_block_time() {
        assert_eq!(Clock::of(7_000, 300).at(20, 300), 7_000);
    }
}
