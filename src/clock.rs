//! Time: the machine's clocks, and a clock for each ledger, from which a leader makes block time.

use ledger::{Ledger, Outcome};
use ledger_replica::{Now, Observer};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The machine's clock, microseconds since the UNIX epoch. It may be set back at any time.
pub(crate) fn wall() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_micros()).unwrap_or(u64::MAX)
}

/// The clocks of the machine, as a host gives them to its ledgers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Machine {
    since: Instant,
}

impl Machine {
    /// The steady clock begins now.
    pub(crate) fn start() -> Self {
        Self { since: Instant::now() }
    }

    /// Microseconds since the start, steadily.
    fn elapsed(self) -> u64 {
        u64::try_from(self.since.elapsed().as_micros()).unwrap_or(u64::MAX)
    }
}

/// A clock that never goes back, not even behind the block time that the network has seen.
///
/// Block time does not go back, so a leader whose machine's clock was set back would let it stand still. No lease would
/// end, and every new transaction would come too late, until the machine's clock has caught up. The same holds for a
/// new leader whose machine is behind the old one's. This clock goes on from where block time was, by the machine's
/// monotonic time, and follows the machine's clock again once that is ahead. Clones share what they have observed.
#[derive(Clone, Debug)]
pub(crate) struct Clock {
    /// Block time when the clock was started, or what newer block time makes of it. Never the machine's clock: one that
    /// was wrong at the start and is set right later must not stay wrong here.
    base: Arc<AtomicU64>,
    machine: Machine,
}

impl Clock {
    /// The clock of a ledger with this newest block time, microseconds since the UNIX epoch. It never shows less.
    pub(crate) fn of(machine: Machine, block_time: u64) -> Self {
        let clock = Self { base: Arc::default(), machine };
        clock.observe(block_time);
        clock
    }

    /// The machine's clock, microseconds since the UNIX epoch: certificates are valid by it.
    pub(crate) fn wall(&self) -> u64 {
        wall()
    }

    /// Microseconds since the UNIX epoch.
    pub(crate) fn now(&self) -> u64 {
        self.at(wall(), self.elapsed())
    }

    /// The time as a replica is told it.
    pub(crate) fn both(&self) -> Now {
        let elapsed = self.elapsed();
        Now { clock: self.at(wall(), elapsed), elapsed }
    }

    /// Takes note of the newest block's time, which the clock is not behind from now on. Where the machine's clock is
    /// behind, the nodes go on from the same block and so agree, but for the time that it took to reach them.
    fn observe(&self, block_time: u64) {
        self.observe_at(block_time, self.elapsed());
    }

    /// Microseconds since the host was started, as the machine's monotonic clock has it.
    pub(crate) fn elapsed(&self) -> u64 {
        self.machine.elapsed()
    }

    fn at(&self, wall: u64, elapsed: u64) -> u64 {
        wall.max(self.base.load(Ordering::Relaxed).saturating_add(elapsed))
    }

    fn observe_at(&self, block_time: u64, elapsed: u64) {
        self.base.store(block_time.saturating_sub(elapsed), Ordering::Relaxed);
    }
}

impl Observer for Clock {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        self.observe(outcome.header.time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_on_when_the_machines_clock_is_set_back_and_follows_it_ahead() {
        let clock = Clock { base: Arc::new(AtomicU64::new(1_000)), machine: Machine::start() };
        assert_eq!(clock.at(1_500, 500), 1_500);
        assert_eq!(clock.at(200, 600), 1_600, "set back: it goes on");
        assert_eq!(clock.at(9_000, 700), 9_000, "set ahead: it follows");
    }

    #[test]
    fn a_machines_clock_that_was_wrong_at_the_start_and_is_set_right_leaves_nothing_behind() {
        let clock = Clock::of(Machine::start(), 1_000);
        assert_eq!((clock.at(900_000, 10), clock.at(2_000, 20)), (900_000, 2_000));
    }

    #[test]
    fn it_is_never_behind_a_block_that_was_seen() {
        let clock = Clock { base: Arc::new(AtomicU64::new(1_000)), machine: Machine::start() };
        clock.observe_at(50_000, 100);
        assert_eq!((clock.at(200, 100), clock.at(200, 150)), (50_000, 50_050));
        clock.observe_at(50_020, 200);
        assert_eq!(clock.at(200, 250), 50_070, "the newest block counts: whoever made it was less ahead");
    }

    #[test]
    fn it_never_starts_behind_block_time() {
        let far_ahead = wall() + 3_600_000_000;
        assert!(Clock::of(Machine::start(), far_ahead).now() >= far_ahead);
    }
}
