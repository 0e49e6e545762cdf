//! Moments of the chain's past: a time, a time of this day, a span ago, or the height of a block.

use super::span::Milliseconds;
use chrono::{DateTime, Local, NaiveTime};

/// A moment as it was typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Moment {
    /// The block of this height.
    Height(u64),
    /// So long ago.
    Ago(Milliseconds),
    /// Microseconds since the UNIX epoch.
    At(u64),
    /// This time of today, where the program runs.
    Today(NaiveTime),
}

/// A moment by the number of a block or by the clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Instant {
    /// The block of this height.
    Height(u64),
    /// Microseconds since the UNIX epoch.
    Time(u64),
}

impl Moment {
    /// The moment, seen from `now` (microseconds since the UNIX epoch).
    pub(crate) fn seen_from(self, now: u64) -> Instant {
        match self {
            Self::Height(height) => Instant::Height(height),
            Self::Ago(Milliseconds(span)) => Instant::Time(now.saturating_sub(span.saturating_mul(1000))),
            Self::At(time) => Instant::Time(time),
            Self::Today(time) => Instant::Time(today_at(time, now).unwrap_or(now)),
        }
    }
}

/// Where clocks are put forward, some times of a day do not exist: none then.
fn today_at(time: NaiveTime, now: u64) -> Option<u64> {
    let now = DateTime::from_timestamp_micros(i64::try_from(now).ok()?)?.with_timezone(&Local);
    let moment = now.date_naive().and_time(time).and_local_timezone(Local).earliest()?;
    u64::try_from(moment.timestamp_micros()).ok()
}

impl std::str::FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(height) = text.parse() {
            return Ok(Self::Height(height));
        }
        let at = DateTime::parse_from_rfc3339(text).ok();
        if let Some(micros) = at.and_then(|time| u64::try_from(time.timestamp_micros()).ok()) {
            return Ok(Self::At(micros));
        }
        for form in ["%H:%M", "%H:%M:%S"] {
            if let Ok(time) = NaiveTime::parse_from_str(text, form) {
                return Ok(Self::Today(time));
            }
        }
        text.parse().map(Self::Ago).map_err(|_: String| {
            "wanted a span ago such as 10m, a time of today such as 14:30 or 14:30:05, a time such as \
             2027-05-01T14:30:00+02:00, or the height of a block such as 4711"
                .to_owned()
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const NOON: u64 = 1_800_014_400_000_000;

    #[test]
    fn a_moment_is_a_height_a_time_a_time_of_today_or_a_span_ago() {
        let seen = |text: &str| text.parse::<Moment>().unwrap().seen_from(NOON);
        assert_eq!(seen("4711"), Instant::Height(4711));
        assert_eq!(seen("10m"), Instant::Time(NOON - 600_000_000));
        assert_eq!(seen("1970-01-01T01:00:01.5+01:00"), Instant::Time(1_500_000));
        let (Instant::Time(minute), Instant::Time(second)) = (seen("14:30"), seen("14:30:05")) else { unreachable!() };
        assert_eq!(second - minute, 5_000_000);
        assert!(minute.abs_diff(NOON) <= 24 * 3_600_000_000 && minute % 60_000_000 == 0, "{minute}");
        assert_eq!(seen("1000000h"), Instant::Time(0), "before the epoch there is nothing");
    }

    #[test]
    fn other_moments_are_refused_with_all_forms() {
        for text in ["", "-1", "soon", "25:00", "14:30:61", "2027-05-01", "0s", "1w", "yesterday"] {
            let error = text.parse::<Moment>().err().unwrap_or_default();
            assert!(error.contains("10m") && error.contains("14:30") && error.contains("height"), "{text:?}: {error}");
        }
    }
}
