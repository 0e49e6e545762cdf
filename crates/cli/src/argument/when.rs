//! Moments: a span from now such as `10m`, or a time such as `2027-05-01T14:30:00+02:00`.

use super::span::Milliseconds;
use chrono::DateTime;

/// A moment as it was typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum When {
    /// So long after now.
    After(Milliseconds),
    /// Microseconds since the UNIX epoch.
    At(u64),
}

impl When {
    /// The moment in microseconds since the UNIX epoch; `now` is told likewise.
    pub(crate) fn micros(self, now: u64) -> u64 {
        match self {
            Self::After(Milliseconds(span)) => now.saturating_add(span.saturating_mul(1000)),
            Self::At(moment) => moment,
        }
    }
}

impl std::str::FromStr for When {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let at = DateTime::parse_from_rfc3339(text).ok();
        if let Some(micros) = at.and_then(|time| u64::try_from(time.timestamp_micros()).ok()) {
            return Ok(Self::At(micros));
        }
        let or = "; or a time in the form of RFC 3339, such as 2027-05-01T14:30:00+02:00";
        text.parse().map(Self::After).map_err(|fault: String| format!("{fault}, from now on{or}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_a_span_from_now_or_a_time() {
        let micros = |text: &str| text.parse::<When>().map(|when| when.micros(7));
        assert_eq!(micros("10m"), Ok(600_000_007));
        assert_eq!(micros("1970-01-01T01:00:01.5+01:00"), Ok(1_500_000));
        assert_eq!(micros("1970-01-02T00:00:00Z"), Ok(86_400_000_000));
    }

    #[test]
    fn other_moments_are_refused_with_both_forms() {
        for text in ["", "10", "soon", "2027-05-01", "2027-05-01T14:30:00", "1969-12-31T23:59:59Z", "0s"] {
            let error = text.parse::<When>().err().unwrap_or_default();
            assert!(error.contains("30s") && error.contains("RFC 3339"), "{text:?}: {error}");
        }
    }
}
