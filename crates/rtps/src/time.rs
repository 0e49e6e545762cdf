//! Time: the steady clock by which the state machine works, and time as it is on the wire (§9.3.2).

use std::time::Duration;

/// The clocks of the machine at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// A clock that never goes back, microseconds since any moment.
    pub steady: u64,
    /// Microseconds since 1970, as people set it. It may jump.
    pub wall: u64,
}

/// Microseconds of a duration; the largest number if it is longer.
pub fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}

/// `Time_t` and `Duration_t`: seconds in 32 bits, and fractions of 2^-32 seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticks(pub u64);

impl Ticks {
    /// No time.
    pub const ZERO: Self = Self(0);
    /// `DURATION_INFINITE`, `TIME_INFINITE`: 0x7fffffff.ffffffff.
    pub const INFINITE: Self = Self(0x7fff_ffff_ffff_ffff);
    /// `TIME_INVALID`: 0xffffffff.ffffffff.
    pub const INVALID: Self = Self(u64::MAX);

    /// Of microseconds; infinite beyond the range.
    pub fn from_micros(micros: u64) -> Self {
        let (seconds, rest) = (micros / 1_000_000, micros % 1_000_000);
        if seconds > 0x7fff_fffe {
            return Self::INFINITE;
        }
        // Rounded up, so that the same microseconds come back.
        Self((seconds << 32) | (rest << 32).div_ceil(1_000_000))
    }

    /// In microseconds, rounded down. None if it is infinite, invalid or negative.
    pub fn to_micros(self) -> Option<u64> {
        let (seconds, fraction) = (self.0 >> 32, self.0 & 0xffff_ffff);
        (seconds < 0x7fff_ffff).then(|| seconds * 1_000_000 + ((fraction * 1_000_000) >> 32))
    }

    /// Of nanoseconds, rounded to the nearest tick; infinite beyond the range.
    pub fn from_nanos(nanos: u64) -> Self {
        let (seconds, rest) = (nanos / 1_000_000_000, nanos % 1_000_000_000);
        if seconds > 0x7fff_fffe {
            return Self::INFINITE;
        }
        Self((seconds << 32) | (((rest << 32) + 500_000_000) / 1_000_000_000))
    }

    /// In nanoseconds, rounded to the nearest. None if it is infinite, invalid or negative.
    pub fn to_nanos(self) -> Option<u64> {
        let (seconds, fraction) = (self.0 >> 32, self.0 & 0xffff_ffff);
        (seconds < 0x7fff_ffff).then(|| seconds * 1_000_000_000 + ((fraction * 1_000_000_000 + (1 << 31)) >> 32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn microseconds_and_nanoseconds_come_back_and_what_is_no_time_is_none() {
        for micros in [0, 1, 999_999, 1_000_000, 1_764_400_000_123_456] {
            assert_eq!(Ticks::from_micros(micros).to_micros(), Some(micros));
        }
        for nanos in [0, 100_000_000, 1_000_000_068_719_476_768] {
            assert_eq!(Ticks::from_nanos(nanos).to_nanos(), Some(nanos));
        }
        assert_eq!([Ticks::INFINITE, Ticks::INVALID].map(Ticks::to_micros), [None, None]);
        assert_eq!(Ticks::from_micros(u64::MAX), Ticks::INFINITE);
    }
}
