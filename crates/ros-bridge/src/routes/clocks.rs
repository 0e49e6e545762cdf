//! The clocks of this machine, as the gate wants them: microseconds since the start of a route, and of the wall.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ledger_gate::gate::Now;

/// No moment is further away: a hundred years, in microseconds.
const STEADY_US_MAX: u64 = 100 * 366 * 24 * 3600 * 1_000_000;

/// Reads the clocks of this machine.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clocks {
    start: Instant,
}

impl Clocks {
    pub(crate) fn start() -> Self {
        Self { start: Instant::now() }
    }

    /// When the steady clock shows so many microseconds.
    pub(crate) fn instant(self, steady: u64) -> Instant {
        let after = Duration::from_micros(steady.min(STEADY_US_MAX));
        self.start.checked_add(after).unwrap_or(self.start)
    }

    /// The steady clock at a moment, in microseconds; 0 before its start.
    pub(crate) fn steady(self, moment: Instant) -> u64 {
        u64::try_from(moment.saturating_duration_since(self.start).as_micros()).unwrap_or(u64::MAX)
    }

    /// Both clocks. The steady one first: a pause between them must not look as if the wall clock were set back.
    pub(crate) fn now(self) -> Now {
        let steady = self.start.elapsed();
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let micros = |duration: Duration| u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        Now { wall: micros(wall), steady: micros(steady) }
    }
}
