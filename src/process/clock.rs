//! Time: the machine's clocks, and the clock of each ledger, whose rule is [`ledger_replica::Clock`].

use ledger::{Ledger, Outcome};
use ledger_base::mutation::{clock_error, suspended};
use ledger_replica::{Now, Observer};
use rustix::time::{ClockId, clock_gettime};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

/// The machine's clock, microseconds since the UNIX epoch. It may be set back at any time.
pub(crate) fn wall() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_micros())
        .unwrap_or(u64::MAX)
        .saturating_add_signed(clock_error())
        .saturating_add(suspended())
}

/// A clock that nobody sets, microseconds. It goes on while the machine sleeps, so that a laptop that wakes up has no clock
/// that jumped.
fn steady() -> u64 {
    let now = clock_gettime(ClockId::Boottime);
    let micros = i128::from(now.tv_sec) * 1_000_000 + i128::from(now.tv_nsec) / 1000;
    u64::try_from(micros).unwrap_or(0).saturating_add(suspended())
}

/// The clocks of the machine, as a host gives them to its ledgers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Machine {
    /// By the steady clock, microseconds.
    since: u64,
    /// An operator says that its wall clock is right.
    pub(crate) is_confirmed: bool,
}

impl Machine {
    /// The steady clock begins now.
    pub(crate) fn start() -> Self {
        Self { since: steady(), is_confirmed: false }
    }

    /// Microseconds since the start, steadily.
    fn elapsed(self) -> u64 {
        steady().saturating_sub(self.since)
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
        let rule = ledger_replica::Clock::of(block_time, machine.elapsed());
        if machine.is_confirmed {
            rule.confirm(wall(), machine.elapsed());
        }
        Self { rule, machine }
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
        let (accepts_until, doubt) = (self.rule.accepts_until(wall, elapsed), self.rule.doubt(wall, elapsed));
        Now { clock: self.rule.at(wall, elapsed), elapsed, accepts_until, doubt }
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
