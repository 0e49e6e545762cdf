//! A budget for log messages: so many in a time, whatever they are about. Without IO.

use std::time::{Duration, Instant};

/// At most so many lines about those who come and leave ...
const LINES_MAX: u32 = 20;
/// ... in this time.
const LINES_IN: Duration = Duration::from_secs(10);

/// Limits log messages about those who come and leave.
#[derive(Debug)]
pub(super) struct LogBudget {
    since: Instant,
    count: u32,
    not_told: u64,
}

impl LogBudget {
    pub(super) fn new(now: Instant) -> Self {
        Self { since: now, count: 0, not_told: 0 }
    }

    /// May one more be logged? Those that may not are counted.
    pub(super) fn spend(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.since) > LINES_IN {
            (self.since, self.count) = (now, 0);
        }
        self.count = self.count.saturating_add(1);
        let may = self.count <= LINES_MAX;
        self.not_told = self.not_told.saturating_add(u64::from(!may));
        may
    }

    /// How many lines were left out, once there is room again.
    pub(super) fn not_told(&mut self, now: Instant) -> Option<u64> {
        let has_room = now.saturating_duration_since(self.since) > LINES_IN;
        (has_room && self.not_told > 0).then(|| std::mem::take(&mut self.not_told))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_limited_and_those_left_out_are_counted() {
        let start = Instant::now();
        let mut lines = LogBudget::new(start);
        let told = (0..100).filter(|number| lines.spend(start + Duration::from_millis(*number))).count();
        assert_eq!(told, LINES_MAX as usize);
        assert_eq!(lines.not_told(start + Duration::from_secs(1)), None);
        let later = start + LINES_IN + Duration::from_secs(1);
        assert_eq!(lines.not_told(later), Some(80));
        assert_eq!(lines.not_told(later), None);
        assert!(lines.spend(later));
    }
}
