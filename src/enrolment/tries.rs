//! How often enrolment may be tried, by everybody together.

use ledger::{Code, Rejection};

/// Tries that may come at once.
pub(super) const BURST_MAX: u64 = 50;
/// Microseconds after which one more try is allowed.
const REFILL: u64 = 100_000;

/// A bucket with a token for each try; it refills with time, and a try that succeeds gives its token back.
#[derive(Default)]
pub(super) struct Tries {
    /// Tokens that are taken.
    taken: u64,
    /// Until when time was turned into tokens, microseconds since the UNIX epoch.
    refilled: u64,
}

impl Tries {
    pub(super) fn take(&mut self, now: u64) -> Result<(), Rejection> {
        let tokens = now.saturating_sub(self.refilled) / REFILL;
        self.taken = self.taken.saturating_sub(tokens);
        // A clock that was set back must not stop enrolment until it has caught up.
        self.refilled = if now < self.refilled { now } else { self.refilled.saturating_add(tokens * REFILL) };
        if self.taken >= BURST_MAX {
            return Err(Rejection::new(Code::Overloaded, "enrolment is tried too often on this node")
                .found(format!("more than {BURST_MAX} tries that failed"))
                .wanted(format!("at most {} a second", 1_000_000 / REFILL))
                .next("try again in a few seconds"));
        }
        self.taken += 1;
        Ok(())
    }

    pub(super) fn give_back(&mut self) {
        self.taken = self.taken.saturating_sub(1);
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    const NOW: u64 = 1_800_000_000_000_000;

    #[test]
    fn a_burst_is_allowed_then_ten_a_second() {
        let mut tries = Tries::default();
        for _ in 0..BURST_MAX {
            tries.take(NOW).unwrap();
        }
        assert_eq!(tries.take(NOW).unwrap_err().code, Code::Overloaded);
        assert!(tries.take(NOW + REFILL - 1).is_err());
        tries.take(NOW + REFILL).unwrap();
        assert!(tries.take(NOW + REFILL).is_err());
    }

    #[test]
    fn tries_that_succeed_do_not_count() {
        let mut tries = Tries::default();
        for _ in 0..BURST_MAX * 2 {
            tries.take(NOW).unwrap();
            tries.give_back();
        }
    }

    #[test]
    fn a_clock_that_jumps_neither_stops_enrolment_nor_overflows() {
        let mut tries = Tries::default();
        for at in [u64::MAX, 0, NOW, 0, u64::MAX] {
            tries.take(at).unwrap();
        }
        for _ in 0..BURST_MAX {
            let _ = tries.take(0);
        }
        assert!(tries.take(0).is_err());
        tries.take(REFILL).unwrap();
    }
}
