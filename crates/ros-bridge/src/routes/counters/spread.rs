//! How long something took, in steps: what a histogram of Prometheus consists of.

/// Upper bounds of the steps, in microseconds. Longer durations have a step of their own.
pub const BOUNDS_US: [u64; 9] = [1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 500_000, 2_000_000];

/// Durations that were observed, by step.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Spread {
    /// How many are in each step, and not in the one before; the last are those above all bounds.
    pub steps: [u64; BOUNDS_US.len() + 1],
    /// All of them together, in microseconds.
    pub sum_us: u64,
}

impl Spread {
    /// How many there are.
    pub fn count(&self) -> u64 {
        self.steps.iter().sum()
    }

    /// Takes one down.
    pub(crate) fn observe(&mut self, us: u64) {
        let step = BOUNDS_US.partition_point(|bound| *bound < us);
        if let Some(count) = self.steps.get_mut(step) {
            *count = count.saturating_add(1);
        }
        self.sum_us = self.sum_us.saturating_add(us);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_duration_is_in_the_first_step_that_holds_it() {
        let mut spread = Spread::default();
        [0, 1_000, 1_001, 2_000_000, 2_000_001, 9_000_000].into_iter().for_each(|us| spread.observe(us));
        assert_eq!(spread.steps, [2, 1, 0, 0, 0, 0, 0, 0, 1, 2]);
        assert_eq!((spread.count(), spread.sum_us), (6, 13_002_002));
    }

    #[test]
    fn what_cannot_be_summed_up_any_more_stays_the_largest_sum() {
        let mut spread = Spread::default();
        [u64::MAX, 5].into_iter().for_each(|us| spread.observe(us));
        assert_eq!((spread.count(), spread.sum_us), (2, u64::MAX));
    }
}
