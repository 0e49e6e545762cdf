//! The clock of this machine, and waiting by it.

use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::time::{Instant, sleep};

/// Between two looks at a clock by which a deadline is measured.
const LOOK: Duration = Duration::from_secs(2);

/// The machine's clock, microseconds since the UNIX epoch.
pub(crate) fn now() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(now.as_micros()).unwrap_or(u64::MAX)
}

/// Waits for a time by this clock, microseconds since the UNIX epoch. Timers stand still while a machine is suspended: the wait ends at
/// most two seconds after it wakes. A clock that was set ahead or back ends the wait, too.
pub async fn wait_by_clock(clock: impl Fn() -> u64, time: Duration) {
    let (begun, start) = (Instant::now(), clock());
    while let Some(pause) = pause(time, begun.elapsed(), start, clock()) {
        sleep(pause).await;
    }
}

/// The time until the next look, in a wait that has taken so long by the timers and whose clock showed `start` at its beginning; none
/// if it is over.
fn pause(time: Duration, elapsed: Duration, start: u64, now: u64) -> Option<Duration> {
    let by_clock = Duration::from_micros(now.saturating_sub(start));
    let was_set_back = Duration::from_micros(start.saturating_sub(now)) > LOOK;
    let left = time.saturating_sub(elapsed.max(by_clock));
    if left.is_zero() || was_set_back { None } else { Some(left.min(LOOK)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: u64 = 3_600_000_000;

    #[test]
    fn a_wait_ends_soon_after_the_machine_wakes_and_otherwise_in_time() {
        let (hour, minute, second) = (Duration::from_secs(3600), Duration::from_secs(60), Duration::from_secs(1));
        let start = 100 * HOUR;
        let after = |elapsed: Duration, jump: i64| {
            let now = start + u64::try_from(elapsed.as_micros()).unwrap_or_default();
            pause(hour, elapsed, start, now.saturating_add_signed(jump))
        };
        assert_eq!([after(minute, 0), after(hour - second, 0), after(hour, 0)], [Some(LOOK), Some(second), None]);
        assert_eq!(after(minute, 17 * HOUR as i64), None, "it was suspended");
        assert_eq!(after(minute, -17 * HOUR as i64), None, "its clock was set back");
        assert_eq!(after(minute, -60_000_000), Some(LOOK), "its clock stands");
    }
}
