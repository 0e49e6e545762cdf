//! The deadline that a reader requests (DDS 1.4 §2.2.3.7). Instances are not told apart: each sample of the topic counts.

/// Shortest time between two reports, microseconds. The deadlines that were missed meanwhile are reported together.
const REPORT_MICROS_MIN: u64 = 10_000;

/// When the next sample is due.
#[derive(Debug)]
pub(super) struct Deadline {
    /// Microseconds; none if it is infinite or zero.
    period: Option<u64>,
    /// The moment from which periods count. None before the first sample.
    since: Option<u64>,
}

impl Deadline {
    pub(super) fn new(period: Option<u64>) -> Self {
        Self { period: period.filter(|period| *period > 0), since: None }
    }

    /// A sample has come.
    pub(super) fn start(&mut self, now: u64) {
        if self.period.is_some() {
            self.since = Some(now);
        }
    }

    /// There is no writer any more.
    pub(super) fn stop(&mut self) {
        self.since = None;
    }

    /// When there is something to report.
    pub(super) fn due(&self) -> Option<u64> {
        Some(self.since?.saturating_add(self.period?.max(REPORT_MICROS_MIN)))
    }

    /// How many periods have passed without a sample since the last report. None if nothing is due.
    pub(super) fn missed(&mut self, now: u64) -> Option<u64> {
        self.due().filter(|due| *due <= now)?;
        let (period, since) = (self.period?, self.since?);
        let count = now.saturating_sub(since).checked_div(period)?;
        self.since = Some(since.saturating_add(count.saturating_mul(period)));
        Some(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_period_without_a_sample_counts_once_from_the_first_sample_on() {
        let mut deadline = Deadline::new(Some(100_000));
        assert_eq!((deadline.due(), deadline.missed(1_000_000)), (None, None), "nothing has come yet");
        deadline.start(1_000_000);
        assert_eq!((deadline.missed(1_099_999), deadline.due()), (None, Some(1_100_000)));
        assert_eq!(deadline.missed(1_100_000), Some(1));
        deadline.start(1_150_000);
        assert_eq!(deadline.missed(1_249_999), None);
        assert_eq!((deadline.missed(1_480_000), deadline.due()), (Some(3), Some(1_550_000)));
        deadline.stop();
        assert_eq!((deadline.missed(9_000_000), deadline.due()), (None, None));
    }

    #[test]
    fn a_tiny_deadline_costs_few_reports_and_an_infinite_one_none() {
        let mut deadline = Deadline::new(Some(1));
        deadline.start(0);
        assert_eq!(
            (deadline.due(), deadline.missed(9_999), deadline.missed(10_000)),
            (Some(10_000), None, Some(10_000))
        );
        for period in [None, Some(0)] {
            let mut deadline = Deadline::new(period);
            deadline.start(0);
            assert_eq!((deadline.due(), deadline.missed(u64::MAX)), (None, None));
        }
    }
}
