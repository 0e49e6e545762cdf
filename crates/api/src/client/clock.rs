//! The node's clock, as seen from here.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// Tells the node's time from the monotonic clock of this machine, so that nobody who sets its wall clock makes
/// transactions expire.
#[derive(Debug)]
pub(crate) struct Clock {
    /// Where our own time starts.
    base: Instant,
    /// The node's clock at `base`, microseconds since the UNIX epoch.
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

    /// Learns that the node's clock was `clock` at some moment between `asked` and now; the middle is assumed.
    pub(crate) fn learn(&self, clock: u64, asked: Instant) {
        let middle = asked + asked.elapsed() / 2;
        self.node.store(clock.wrapping_sub(micros(self.base, middle)), Ordering::Relaxed);
        self.doubted.store(false, Ordering::Relaxed);
    }

    pub(crate) fn doubt(&self) {
        self.doubted.store(true, Ordering::Relaxed);
    }

    pub(crate) fn doubted(&self) -> bool {
        self.doubted.load(Ordering::Relaxed)
    }
}

fn micros(from: Instant, to: Instant) -> u64 {
    u64::try_from(to.saturating_duration_since(from).as_micros()).unwrap_or(u64::MAX)
}
