//! Time: the machine's clocks, and the clock of each ledger, whose rule is [`ledger_replica::Clock`].

use ledger::{Ledger, Outcome};
use ledger_replica::{Now, Observer};
use std::sync::Arc;
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

/// The clock of one ledger on this machine. Clones share what they have observed.
#[derive(Clone, Debug)]
pub(crate) struct Clock {
    rule: ledger_replica::Clock,
    machine: Machine,
}

impl Clock {
    /// The clock of a ledger with this newest block time, microseconds since the UNIX epoch. It never shows less.
    pub(crate) fn of(machine: Machine, block_time: u64) -> Self {
        Self { rule: ledger_replica::Clock::of(block_time, machine.elapsed()), machine }
    }

    /// The machine's clock, microseconds since the UNIX epoch: certificates are valid by it.
    pub(crate) fn wall(&self) -> u64 {
        wall()
    }

    /// Microseconds since the UNIX epoch.
    pub(crate) fn now(&self) -> u64 {
        self.both().clock
    }

    /// The time as a replica is told it.
    pub(crate) fn both(&self) -> Now {
        let elapsed = self.elapsed();
        let wall = wall();
        Now { clock: self.rule.at(wall, elapsed), elapsed, accepts_until: self.rule.accepts_until(wall, elapsed) }
    }

    /// Microseconds since the host was started, as the machine's monotonic clock has it.
    pub(crate) fn elapsed(&self) -> u64 {
        self.machine.elapsed()
    }
}

impl Observer for Clock {
    fn executed(&self, outcome: &Arc<Outcome>, _ledger: &Ledger) {
        self.rule.observe(outcome.header.time, self.elapsed());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_never_starts_behind_block_time() {
        let far_ahead = wall() + 3_600_000_000;
        assert!(Clock::of(Machine::start(), far_ahead).now() >= far_ahead);
    }
}
