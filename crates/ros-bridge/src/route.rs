//! Routes: one topic, one direction. Each is a task of its own; what it decides is in a part without IO.

pub(crate) mod from_ledger;
pub(crate) mod local;
pub(crate) mod to_ledger;

use std::time::{Instant, SystemTime, UNIX_EPOCH};

use tokio::sync::watch;

use crate::gate::Now;

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

    pub(crate) fn now(self) -> Now {
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let micros = |duration: std::time::Duration| u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        Now { wall: micros(wall), steady: micros(self.start.elapsed()) }
    }
}
