//! How often enrolment, or opening a session of the console, may fail: by one source, and by everybody together.
//!
//! Only what is refused counts, and who comes with a good secret is never refused for the guesses of others.

use crate::process::caller::network_of;
use ledger_base::rejection::{Code, Rejection};
use std::collections::HashMap;
use std::net::IpAddr;

/// Failed tries of one source that may come at once.
pub(super) const BURST_MAX: u64 = 30;
/// Microseconds after which a source may try once more.
const REFILL: u64 = 200_000;
/// Failed tries of all sources that may come at once.
const ALL_BURST_MAX: u64 = 300;
/// Microseconds after which one more is allowed to all together.
const ALL_REFILL: u64 = 20_000;
/// Most sources that are told apart; beyond it the rest share one bucket.
const SOURCES_MAX: usize = 1024;

/// Recent tries.
#[derive(Default)]
pub(crate) struct Tries {
    all: Bucket,
    sources: HashMap<IpAddr, Bucket>,
    others: Bucket,
}

impl Tries {
    /// Counts a failed try.
    ///
    /// # Errors
    /// [`Code::Overloaded`] if there were too many: then it is not even looked at closely.
    pub(crate) fn take(&mut self, source: IpAddr, now: u64) -> Result<(), Rejection> {
        let source = network_of(source);
        if self.sources.len() >= SOURCES_MAX && !self.sources.contains_key(&source) {
            self.sources.retain(|_, bucket| !bucket.is_full(REFILL, now));
        }
        let bucket = match self.sources.len() < SOURCES_MAX || self.sources.contains_key(&source) {
            true => self.sources.entry(source).or_default(),
            false => &mut self.others,
        };
        if !bucket.take(BURST_MAX, REFILL, now) {
            return Err(overloaded("from this address", BURST_MAX, REFILL));
        }
        if !self.all.take(ALL_BURST_MAX, ALL_REFILL, now) {
            return Err(overloaded("on this node", ALL_BURST_MAX, ALL_REFILL));
        }
        Ok(())
    }
}

impl Tries {
    /// A try that was counted did not fail.
    pub(crate) fn give_back(&mut self, source: IpAddr) {
        self.all.give_back();
        self.sources.get_mut(&network_of(source)).unwrap_or(&mut self.others).give_back();
    }
}

fn overloaded(whose: &str, burst: u64, refill: u64) -> Rejection {
    Rejection::new(Code::Overloaded, format!("too many failed attempts {whose}"))
        .found(format!("more than {burst} failed attempts"))
        .wanted(format!("at most {} a second", 1_000_000 / refill))
        .next("try again in a few seconds, with the right secret or key")
}

/// A bucket with a token for each try; it refills with time.
#[derive(Default)]
struct Bucket {
    /// Tokens that are taken.
    taken: u64,
    /// Until when time was turned into tokens, microseconds since the UNIX epoch.
    refilled: u64,
}

impl Bucket {
    fn refill(&mut self, every: u64, now: u64) {
        let tokens = now.saturating_sub(self.refilled) / every;
        self.taken = self.taken.saturating_sub(tokens);
        // A clock that was set back must not stop enrolment until it has caught up.
        self.refilled = if now < self.refilled { now } else { self.refilled.saturating_add(tokens * every) };
    }

    fn take(&mut self, burst: u64, every: u64, now: u64) -> bool {
        self.refill(every, now);
        let free = self.taken < burst;
        self.taken += u64::from(free);
        free
    }

    fn give_back(&mut self) {
        self.taken = self.taken.saturating_sub(1);
    }

    fn is_full(&mut self, every: u64, now: u64) -> bool {
        self.refill(every, now);
        self.taken == 0
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use std::net::Ipv6Addr;

    const NOW: u64 = 1_800_000_000_000_000;

    fn source(last: u8) -> IpAddr {
        [10, 0, 0, last].into()
    }

    #[test]
    fn a_burst_is_allowed_then_five_a_second_and_other_sources_do_not_feel_it() {
        let mut tries = Tries::default();
        for _ in 0..BURST_MAX {
            tries.take(source(1), NOW).unwrap();
        }
        assert_eq!(tries.take(source(1), NOW).unwrap_err().code, Code::Overloaded);
        assert!(tries.take(source(1), NOW + REFILL - 1).is_err());
        tries.take(source(2), NOW).unwrap();
        tries.take(source(1), NOW + REFILL).unwrap();
        assert!(tries.take(source(1), NOW + REFILL).is_err());
    }

    #[test]
    fn all_sources_together_are_limited_too_and_take_bounded_memory() {
        let mut tries = Tries::default();
        let from = |number: u32| IpAddr::from(number.to_be_bytes());
        let passed = (0..100_000).filter(|number| tries.take(from(*number), NOW).is_ok()).count();
        assert_eq!(passed as u64, ALL_BURST_MAX);
        assert!(tries.sources.len() <= SOURCES_MAX);
        tries.take(from(7), NOW + 60_000_000).unwrap();
    }

    #[test]
    fn tries_that_succeed_do_not_count() {
        let mut tries = Tries::default();
        for _ in 0..ALL_BURST_MAX * 2 {
            tries.take(source(1), NOW).unwrap();
            tries.give_back(source(1));
        }
    }

    #[test]
    fn a_whole_network_of_ipv6_is_one_source() {
        let mut tries = Tries::default();
        let from = |last: u64| IpAddr::from(Ipv6Addr::from((0x2001_0db8_u128 << 96) | u128::from(last)));
        let passed = (0..BURST_MAX * 2).filter(|last| tries.take(from(*last), NOW).is_ok()).count();
        assert_eq!(passed as u64, BURST_MAX);
    }

    #[test]
    fn a_clock_that_jumps_neither_stops_enrolment_nor_overflows() {
        let mut tries = Tries::default();
        for at in [u64::MAX, 0, NOW, 0, u64::MAX] {
            tries.take(source(1), at).unwrap();
        }
        for _ in 0..BURST_MAX {
            let _ = tries.take(source(1), 0);
        }
        assert!(tries.take(source(1), 0).is_err());
        tries.take(source(1), REFILL).unwrap();
    }
}
