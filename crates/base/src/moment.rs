//! Moments in time as text.

use time::OffsetDateTime;

/// Microseconds since the UNIX epoch as RFC 3339 in UTC, to the microsecond: `2026-11-21T01:37:35.000250Z`. A moment beyond the
/// year 9999, which RFC 3339 cannot write, stays a number.
pub fn rfc3339(micros: u64) -> String {
    utc(micros).map_or_else(|| number(micros), |at| format!("{}.{:06}Z", seconds(at), at.microsecond()))
}

/// The same to the second: `2026-11-21T01:37:35Z`.
pub fn rfc3339_seconds(micros: u64) -> String {
    utc(micros).map_or_else(|| number(micros), |at| format!("{}Z", seconds(at)))
}

fn utc(micros: u64) -> Option<OffsetDateTime> {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(micros) * 1000).ok()
}

fn seconds(at: OffsetDateTime) -> String {
    let (year, month, day) = at.to_calendar_date();
    let (hour, minute, second) = at.to_hms();
    format!("{year:04}-{:02}-{day:02}T{hour:02}:{minute:02}:{second:02}", u8::from(month))
}

fn number(micros: u64) -> String {
    format!("{micros} µs")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_instants_read_as_their_dates() {
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00.000000Z");
        assert_eq!(rfc3339(951_782_400_000_000), "2000-02-29T00:00:00.000000Z");
        assert_eq!(rfc3339(1_795_225_055_000_250), "2026-11-21T01:37:35.000250Z");
        assert_eq!(rfc3339(4_107_542_399_999_999), "2100-02-28T23:59:59.999999Z");
    }

    #[test]
    fn moments_are_dates_of_the_calendar_to_the_second() {
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_795_229_428, "2026-11-21T02:50:28Z"),
        ] {
            assert_eq!(rfc3339_seconds(seconds * 1_000_000), text);
            assert_eq!(rfc3339_seconds(seconds * 1_000_000 + 999_999), text);
        }
    }

    #[test]
    fn moments_beyond_the_calendar_are_numbers() {
        assert_eq!(rfc3339(253_402_300_799_999_999), "9999-12-31T23:59:59.999999Z");
        assert_eq!(rfc3339(253_402_300_800_000_000), "253402300800000000 µs");
        assert_eq!(rfc3339_seconds(u64::MAX), format!("{} µs", u64::MAX));
    }
}
