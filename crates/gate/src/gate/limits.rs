//! The limits of a grant: how much may pass of its holder, how old, and how fast it may ask the robot to go.

use std::collections::BTreeMap;

use ledger_contract::Limits;

use super::Refused;
use crate::sample::Sample;
use crate::speed::{Fault, Layout, Speeds};

/// Most holders whose rate is remembered at a time.
const HOLDERS_MAX: usize = 1024;
/// One message, in units of one in a thousand seconds, for a microsecond: a rate fills a bucket with its own number each microsecond.
const MESSAGE: u64 = 1_000_000_000;
/// One second in microseconds.
const SECOND_US: u64 = 1_000_000;

/// The limits of a grant as the gate reads them. The windows of time are for the ledger, which ends the grant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Bounds {
    /// Most messages in a thousand seconds.
    pub(super) rate_mhz: Option<u64>,
    /// Greatest age, in microseconds.
    pub(super) max_age_us: Option<u64>,
    /// The largest speeds.
    speeds: Speeds,
}

impl From<&Limits> for Bounds {
    fn from(limits: &Limits) -> Self {
        let Limits { max_rate_mhz, max_age_ms, max_linear_mm_s, max_angular_mrad_s, between: _ } = limits;
        Self {
            rate_mhz: *max_rate_mhz,
            max_age_us: max_age_ms.map(|age| age.saturating_mul(1000)),
            speeds: Speeds { linear_mm_s: *max_linear_mm_s, angular_mrad_s: *max_angular_mrad_s },
        }
    }
}

impl Bounds {
    /// These, and no more than the largest speeds of the robot itself.
    pub(super) fn within(self, own: Speeds) -> Self {
        Self { speeds: self.speeds.and(own), ..self }
    }

    /// Is there a largest speed?
    pub(super) fn limit_speed(&self) -> bool {
        !self.speeds.is_none()
    }

    /// Brings samples down to the largest speeds, and counts those that were faster.
    ///
    /// # Errors
    /// [`Refused::BadPayload`], [`Refused::BadSpeed`].
    pub(super) fn slow_down(&self, layout: Option<Layout>, samples: &mut [Sample]) -> Result<usize, Refused> {
        let Some(layout) = layout else { return Ok(0) };
        let mut clamped = 0;
        for sample in samples {
            let slower = layout.slow_down(sample, self.speeds).map_err(|fault| match fault {
                Fault::Layout => Refused::BadPayload,
                Fault::NotFinite | Fault::TooLarge => Refused::BadSpeed,
            })?;
            if let Some(slower) = slower {
                *sample = slower;
                clamped += 1;
            }
        }
        Ok(clamped)
    }
}

/// How much of each holder may pass: a bucket that a rate fills and messages empty. It outlives grants, so that a new one is no way
/// around the limit.
#[derive(Debug, Default)]
pub(super) struct Rates {
    buckets: BTreeMap<String, Bucket>,
}

#[derive(Clone, Copy, Debug)]
struct Bucket {
    level: u64,
    /// When it had that level, by the steady clock (microseconds).
    since: u64,
    /// The rate that fills it.
    rate: u64,
}

impl Rates {
    /// Takes so many messages of a holder out of its bucket, or nothing if they are too many.
    ///
    /// # Errors
    /// [`Refused::TooFast`]; [`Refused::TooManyPublishers`] if there is no room for another holder.
    pub(super) fn take(&mut self, holder: &str, rate: Option<u64>, messages: usize, now: u64) -> Result<(), Refused> {
        let Some(rate) = rate else { return Ok(()) };
        if rate == 0 {
            return Err(Refused::TooFast);
        }
        let known = self.buckets.get(holder).copied();
        if known.is_none() && !self.has_room(now) {
            return Err(Refused::TooManyPublishers);
        }
        let mut bucket = known.map_or(Bucket::full(rate, now), |bucket| bucket.at(rate, now));
        let wanted = u64::try_from(messages).unwrap_or(u64::MAX).saturating_mul(MESSAGE);
        let left = bucket.level.checked_sub(wanted);
        bucket.level = left.unwrap_or(bucket.level);
        self.buckets.insert(holder.to_owned(), bucket);
        left.map(|_| ()).ok_or(Refused::TooFast)
    }

    /// Is there room for another? A bucket that is full again is as good as none.
    fn has_room(&mut self, now: u64) -> bool {
        if self.buckets.len() >= HOLDERS_MAX {
            self.buckets.retain(|_, bucket| bucket.at(bucket.rate, now).level < capacity(bucket.rate));
        }
        self.buckets.len() < HOLDERS_MAX
    }
}

impl Bucket {
    fn full(rate: u64, now: u64) -> Self {
        Self { level: capacity(rate), since: now, rate }
    }

    /// The bucket at a moment. Where the rate has changed since the last message, the time until now counts by the lower one.
    fn at(self, rate: u64, now: u64) -> Self {
        let elapsed = now.saturating_sub(self.since);
        let filled = elapsed.saturating_mul(rate.min(self.rate));
        Self { level: self.level.saturating_add(filled).min(capacity(rate)), since: self.since.max(now), rate }
    }
}

/// One second's worth of a rate, at least one message.
fn capacity(rate: u64) -> u64 {
    rate.saturating_mul(SECOND_US).max(MESSAGE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// How many of a holder's messages pass, one at each of these times.
    fn passes(rates: &mut Rates, rate: u64, times: impl IntoIterator<Item = u64>) -> usize {
        times.into_iter().filter(|now| rates.take("a", Some(rate), 1, *now).is_ok()).count()
    }

    #[test]
    fn one_seconds_worth_passes_at_once_and_the_rate_after_that() {
        for (rate, at_once) in [(50_000, 50), (1_500, 1), (1_000, 1), (1, 1)] {
            let mut rates = Rates::default();
            assert_eq!(passes(&mut rates, rate, [7; 200]), at_once, "{rate}");
            let pause = MESSAGE / rate;
            let later = (1..=100).map(|number| 7 + SECOND_US + number * pause);
            assert_eq!(passes(&mut rates, rate, later), 100, "{rate}: who keeps to it loses nothing");
        }
        let mut rates = Rates::default();
        let twice_as_often = (0..10_000).map(|number| number * 10_000);
        assert_eq!(passes(&mut rates, 50_000, twice_as_often), 50 + 50 * 100 - 1, "100 s of twice the rate");
    }

    #[test]
    fn a_transaction_takes_as_much_as_it_has_messages_and_all_of_it_or_nothing() {
        let mut rates = Rates::default();
        assert_eq!(rates.take("a", Some(5_000), 6, 0), Err(Refused::TooFast));
        assert_eq!(rates.take("a", Some(5_000), 5, 0), Ok(()));
        assert_eq!(rates.take("a", Some(5_000), 1, 0), Err(Refused::TooFast));
        assert_eq!(rates.take("b", Some(5_000), 5, 0), Ok(()), "each holder has its own");
        assert_eq!(rates.take("c", Some(0), 1, 0), Err(Refused::TooFast), "no rate at all");
        assert_eq!(rates.take("a", None, 1000, 0), Ok(()));
    }

    #[test]
    fn another_rate_fills_nothing_up() {
        let mut rates = Rates::default();
        assert_eq!(passes(&mut rates, 50_000, [0; 60]), 50);
        assert_eq!(passes(&mut rates, 90_000, [0; 60]), 0);
        assert_eq!(passes(&mut rates, 2_000, [SECOND_US; 60]), 2);
        assert_eq!(passes(&mut rates, 50_000, [2 * SECOND_US; 60]), 2, "a second at the lower rate");
    }

    #[test]
    fn holders_are_forgotten_only_when_that_fills_nothing_up() {
        let mut rates = Rates::default();
        for number in 0..HOLDERS_MAX {
            assert_eq!(rates.take(&number.to_string(), Some(10_000), 1, 0), Ok(()));
        }
        let full = SECOND_US / 10;
        assert_eq!(rates.take("late", Some(10_000), 1, full - 1), Err(Refused::TooManyPublishers));
        assert_eq!(rates.take("late", Some(10_000), 1, full), Ok(()));
        assert_eq!(rates.buckets.len(), 1);
    }

    proptest! {
        #[test]
        fn no_numbers_whatever_pass_more_than_the_rate_allows_or_overflow(
            steps in proptest::collection::vec((any::<u64>(), any::<usize>(), any::<u64>()), 1..50),
            tiny in proptest::collection::vec((1..200_000_u64, 1..20_usize, 0..50_000_u64), 1..200),
        ) {
            let mut rates = Rates::default();
            for (rate, messages, now) in steps {
                // Whatever the answer, it is one.
                let _ = rates.take("a", Some(rate), messages, now);
            }
            let mut rates = Rates::default();
            let highest = tiny.iter().map(|(rate, ..)| *rate).max().unwrap_or(0);
            let (mut now, mut passed) = (0, 0);
            for (rate, messages, pause) in tiny {
                now += pause;
                passed += if rates.take("a", Some(rate), messages, now).is_ok() { messages as u64 } else { 0 };
            }
            prop_assert!(passed * MESSAGE <= capacity(highest) + now * highest);
        }
    }
}
