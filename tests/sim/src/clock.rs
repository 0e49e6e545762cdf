//! The clocks of a machine, in virtual time: the wall clock, which may be wrong and jump, and the monotonic one.
//!
//! A node makes of them the time of its ledger by the rule of the replica. All times are in microseconds.

use ledger_raft::ClockDoubt;
use ledger_replica as replica;

/// Virtual time 0 as a wall clock shows it: 2030-01-01, in microseconds since the UNIX epoch.
pub const EPOCH: u64 = 1_893_456_000_000_000;
/// One second.
pub const SECOND: u64 = 1_000_000;
/// One millisecond.
pub const MILLISECOND: u64 = 1_000;

/// The clocks of one machine.
#[derive(Clone, Debug)]
pub struct Clock {
    /// How much the wall clock is ahead (or behind).
    offset: i64,
    /// By how many millionths it runs too fast (or slow).
    drift_ppm: i64,
    /// The process's view of the time.
    rule: replica::Clock,
    /// The latest that the wall clock has shown, but for what it shows now.
    latest: u64,
    /// Monotonic time when the process was started. Below zero if the machine ran fast before it was set right.
    started: i64,
}

impl Clock {
    /// A machine whose clock is wrong by `offset` and runs wrong by `drift_ppm`.
    pub fn new(offset: i64, drift_ppm: i64) -> Self {
        Self { offset, drift_ppm, rule: replica::Clock::of(0, 0), latest: 0, started: 0 }
    }

    /// Somebody sets the wall clock.
    pub fn step(&mut self, virtual_now: u64, by: i64) {
        self.latest = self.latest(virtual_now);
        self.offset += by;
    }

    /// The wall clock is set right, and kept right. The process sees no jump of its monotonic clock.
    pub fn heal(&mut self, virtual_now: u64) {
        let elapsed = self.elapsed(virtual_now);
        self.latest = self.latest(virtual_now);
        (self.offset, self.drift_ppm) = (0, 0);
        self.started = signed(virtual_now) - signed(elapsed);
    }

    /// The process starts, with a state that has seen this block time.
    pub fn start(&mut self, virtual_now: u64, block_time: u64) {
        self.rule = replica::Clock::of(block_time, 0);
        self.started = signed(self.monotonic(virtual_now));
    }

    /// The process has executed a block of this time.
    pub fn observe(&mut self, virtual_now: u64, block_time: u64) {
        self.rule.observe(block_time, self.elapsed(virtual_now));
    }

    /// The process's view of the time, microseconds since the UNIX epoch.
    pub fn now(&self, virtual_now: u64) -> u64 {
        self.rule.at(self.wall(virtual_now), self.elapsed(virtual_now))
    }

    /// Does the process doubt its machine's clock?
    pub fn doubt(&self, virtual_now: u64) -> Option<ClockDoubt> {
        self.rule.doubt(self.wall(virtual_now), self.elapsed(virtual_now))
    }

    /// The latest block time that the process acknowledges, as a voter.
    pub fn accepts_until(&self, virtual_now: u64) -> u64 {
        self.rule.accepts_until(self.wall(virtual_now), self.elapsed(virtual_now))
    }

    /// The machine's clock.
    pub fn wall(&self, virtual_now: u64) -> u64 {
        (EPOCH + self.monotonic(virtual_now)).saturating_add_signed(self.offset)
    }

    /// The latest time that the machine's clock has shown.
    pub fn latest(&self, virtual_now: u64) -> u64 {
        self.latest.max(self.wall(virtual_now))
    }

    fn elapsed(&self, virtual_now: u64) -> u64 {
        self.monotonic(virtual_now).saturating_add_signed(-self.started)
    }

    fn monotonic(&self, virtual_now: u64) -> u64 {
        let drift = i128::from(virtual_now) * i128::from(self.drift_ppm) / 1_000_000;
        virtual_now.saturating_add_signed(i64::try_from(drift).unwrap_or(0))
    }
}

/// Virtual times are short.
fn signed(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}
