//! The highest rate of a route; without IO.

use std::time::{Duration, Instant};

use ledger_base::settings::Section;

/// Highest `max_rate_hz`.
pub(super) const RATE_HZ_MAX: u64 = 10_000;
/// The setting of the highest rate.
pub(super) const RATE_KEY: &str = "max_rate_hz";

/// Reads the highest rate; none if it is not set.
pub(super) fn read_rate(section: &mut Section<'_, '_>) -> Option<u32> {
    let mut max_rate_hz = None;
    section.integer(RATE_KEY, 1..=RATE_HZ_MAX, &mut max_rate_hz);
    max_rate_hz.and_then(|hz: u64| u32::try_from(hz).ok())
}

/// Lets an item pass at most so often. Of those that come sooner the newest waits for its turn: the last one of a
/// stream, such as the command to stop, always passes.
#[derive(Debug)]
pub(super) struct Pace<T> {
    /// Between two items; none = any.
    gap: Option<Duration>,
    /// Before it nothing passes.
    next: Option<Instant>,
    waiting: Option<T>,
    /// Items that newer ones replaced, and nobody has counted.
    thinned: u64,
}

impl<T> Pace<T> {
    /// So many a second; none = any number.
    pub(super) fn new(max_rate_hz: Option<u32>) -> Self {
        let gap = max_rate_hz.map(|hz| Duration::from_secs(1) / hz.max(1));
        Self { gap, next: None, waiting: None, thinned: 0 }
    }

    /// Does every item pass at once?
    pub(super) fn is_unlimited(&self) -> bool {
        self.gap.is_none()
    }

    /// Gives the item back if it may pass now. Else it waits, in the place of the one that waited.
    pub(super) fn offer(&mut self, item: T, now: Instant) -> Option<T> {
        let Some(gap) = self.gap else { return Some(item) };
        if self.waiting.replace(item).is_some() {
            self.thinned = self.thinned.saturating_add(1);
        }
        if self.next.is_some_and(|next| now < next) {
            return None;
        }
        self.next = Some(now + gap);
        self.waiting.take()
    }

    /// When the one that waits may pass; none if none waits.
    pub(super) fn due(&self) -> Option<Instant> {
        self.next.filter(|_| self.waiting.is_some())
    }

    /// The one that waits, if its time has come.
    pub(super) fn take(&mut self, now: Instant) -> Option<T> {
        let waiting = self.waiting.take()?;
        self.offer(waiting, now)
    }

    /// How many have been replaced since the last call.
    pub(super) fn thinned(&mut self) -> u64 {
        std::mem::take(&mut self.thinned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_rate_everything_passes_at_once() {
        let (mut pace, now) = (Pace::new(None), Instant::now());
        assert!((0..100).all(|item| pace.offer(item, now) == Some(item)));
        assert_eq!((pace.due(), pace.thinned()), (None, 0));
    }

    #[test]
    fn of_a_stream_that_is_too_fast_the_newest_pass_and_the_last_one_always() {
        let (mut pace, start) = (Pace::new(Some(10)), Instant::now());
        let mut passed = Vec::new();
        for ms in 0..=1000 {
            let now = start + Duration::from_millis(ms);
            if pace.due().is_some_and(|due| due <= now) {
                passed.extend(pace.take(now));
            }
            passed.extend(pace.offer(ms, now));
        }
        let last = pace.due().unwrap_or(start);
        passed.extend(pace.take(last));
        assert_eq!(passed, [0, 99, 199, 299, 399, 499, 599, 699, 799, 899, 999, 1000]);
        assert_eq!(pace.thinned(), 1001 - 12);
        assert_eq!(last, start + Duration::from_millis(1100));
    }

    #[test]
    fn a_stream_that_is_slow_enough_waits_for_nothing() {
        let (mut pace, start) = (Pace::new(Some(50)), Instant::now());
        assert!((0..10).all(|item| pace.offer(item, start + Duration::from_millis(20) * item) == Some(item)));
        assert_eq!(pace.take(start + Duration::from_secs(1)), None);
    }
}
