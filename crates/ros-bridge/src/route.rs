//! Routes: one topic of one service. Each is a task of its own; its decisions are in parts without IO. The kinds are
//! one table, [`kind::KINDS`], and each kind is a file.

mod action_client;
mod action_server;
mod actions;
mod calls;
mod from_ledger;
mod holder;
pub(crate) mod kind;
mod latched;
pub(crate) mod local;
mod pace;
mod points;
mod service_client;
mod service_server;
mod side_door;
pub(crate) mod silence;
mod stopping;
mod to_ledger;

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use tokio::sync::watch;

use ledger_gate::gate::Now;

/// Highest `max_rate_hz`.
pub(crate) const RATE_HZ_MAX: u64 = 10_000;
/// No moment is further away: a hundred years, in microseconds.
const STEADY_US_MAX: u64 = 100 * 366 * 24 * 3600 * 1_000_000;

/// Tells routes to end. They also end when whoever tells is gone.
pub(crate) type Stop = watch::Receiver<bool>;

/// Waits until it is time to end.
pub(crate) async fn stopped(stop: &mut Stop) {
    // An error means that nobody is left who could tell.
    let _told = stop.wait_for(|stop| *stop).await;
}

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
