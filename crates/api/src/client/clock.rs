//! The node's clock, as seen from here.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// A block that was just executed is not older than this by the node's clock, microseconds.
const BLOCK_AGE_MAX: u64 = 1_000_000;

/// Tells the node's time from the monotonic clock of this machine, so that nobody who sets its wall clock makes
/// transactions expire.
#[derive(Debug)]
pub(crate) struct Clock {
    /// Where our own time starts.
    base: Instant,
    /// The node's clock at `base`, modulo 2^64 (a node may start before us): microseconds since the UNIX epoch.
    node: AtomicU64,
    /// A node disagreed with our dates since we asked.
    doubted: AtomicBool,
}

impl Clock {
    pub(crate) fn new() -> Self {
        Self { base: Instant::now(), node: AtomicU64::new(0), doubted: AtomicBool::new(false) }
    }

    /// The node's clock now.
    pub(crate) fn now(&self) -> u64 {
        self.node.load(Ordering::Relaxed).wrapping_add(micros(self.base, Instant::now()))
    }

    /// Learns that the node's clock showed `clock`, microseconds since the UNIX epoch, at a moment.
    pub(crate) fn learn(&self, clock: u64, moment: Instant) {
        self.node.store(clock.wrapping_sub(micros(self.base, moment)), Ordering::Relaxed);
    }

    /// Takes note of the time of a block that was just executed. Block time that is ahead of the machines' clocks runs slower
    /// than they do: then what is signed by this clock would live longer than it should.
    pub(crate) fn executed(&self, block_time: u64) {
        if self.now() < block_time {
            // The clock of the leader is ahead of the node's. Calls that are dated by the node's would expire too early.
            self.learn(block_time, Instant::now());
        }
        if self.now() > block_time.saturating_add(BLOCK_AGE_MAX) {
            self.doubt();
        }
    }

    pub(crate) fn doubt(&self) {
        self.doubted.store(true, Ordering::Relaxed);
    }

    /// Was there doubt since this was asked?
    pub(crate) fn take_doubt(&self) -> bool {
        self.doubted.swap(false, Ordering::Relaxed)
    }
}

/// The middle between asking and now, when the answer came: about when the node looked at its clock.
pub(crate) fn middle(asked: Instant) -> Instant {
    asked + asked.elapsed() / 2
}

fn micros(from: Instant, to: Instant) -> u64 {
    u64::try_from(to.saturating_duration_since(from).as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_is_never_behind_a_block_that_was_executed() {
        let clock = Clock::new();
        clock.learn(100_000_000, Instant::now());
        clock.executed(100_900_000);
        assert!(clock.now() >= 100_900_000 && !clock.take_doubt());
    }

    #[test]
    fn a_clock_that_has_run_ahead_of_block_time_is_doubted_once() {
        let clock = Clock::new();
        clock.learn(100_000_000, Instant::now());
        clock.executed(100_000_000);
        assert!(!clock.take_doubt(), "a block takes its time");
        clock.executed(100_000_000 - BLOCK_AGE_MAX - 1);
        assert!(clock.take_doubt() && !clock.take_doubt());
    }
}
