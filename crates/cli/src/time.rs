//! Moments and spans for people. Everywhere else times are microseconds since the UNIX epoch.

use chrono::{DateTime, Local};
pub(crate) use ledger_base::moment::rfc3339;
pub(crate) use ledger_base::units::span;
use std::time::{SystemTime, UNIX_EPOCH};

/// This machine's clock, microseconds since the UNIX epoch.
pub(crate) fn now() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .ok()
        .and_then(|elapsed| u64::try_from(elapsed.as_micros()).ok())
        .unwrap_or_default()
}

/// A moment in the local time of this machine, to the second.
pub(crate) fn moment(micros: u64) -> String {
    local(micros, "%Y-%m-%d %H:%M:%S %:z")
}

/// A time of day in the local time of this machine, to the millisecond; for streams.
pub(crate) fn time_of_day(micros: u64) -> String {
    local(micros, "%H:%M:%S%.3f")
}

fn local(micros: u64, format: &str) -> String {
    i64::try_from(micros)
        .ok()
        .and_then(DateTime::from_timestamp_micros)
        .map_or_else(|| format!("{micros} µs"), |utc| utc.with_timezone(&Local).format(format).to_string())
}

/// A moment as seen from another: `in 10 s`, `3 min ago`, `now`.
pub(crate) fn relative(micros: u64, from: u64) -> String {
    match micros.cmp(&from) {
        std::cmp::Ordering::Equal => "now".to_owned(),
        std::cmp::Ordering::Greater => format!("in {}", span(micros - from)),
        std::cmp::Ordering::Less => format!("{} ago", span(from - micros)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_times_say_whether_they_are_past() {
        assert_eq!(relative(11_000_000, 1_000_000), "in 10 s");
        assert_eq!(relative(1_000_000, 11_000_000), "10 s ago");
        assert_eq!(relative(5, 5), "now");
    }

    #[test]
    fn moments_beyond_the_calendar_are_numbers() {
        assert_eq!(moment(u64::MAX), format!("{} µs", u64::MAX));
        assert!(moment(1_700_000_000_000_000).starts_with("2023-11-1"));
    }
}
