//! Percentiles of some numbers.

use serde::Serialize;

/// Percentiles; zeros if there are no numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Percentiles {
    /// Half are less.
    pub p50: f64,
    /// The 95th percentile.
    pub p95: f64,
    /// The 99th percentile.
    pub p99: f64,
    /// The largest.
    pub max: f64,
    /// How many there are.
    pub count: usize,
}

impl Percentiles {
    /// Of these numbers, by nearest rank.
    pub(crate) fn of(numbers: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = numbers.filter(|number| number.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let index = (share * sorted.len() as f64).ceil() as usize;
            sorted.get(index.saturating_sub(1)).copied().unwrap_or_default()
        };
        Self { p50: rank(0.5), p95: rank(0.95), p99: rank(0.99), max: rank(1.0), count: sorted.len() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_numbers_that_were_there() {
        let of = Percentiles::of((1..=200).rev().map(f64::from));
        assert_eq!((of.p50, of.p95, of.p99, of.max, of.count), (100.0, 190.0, 198.0, 200.0, 200));
        assert_eq!(Percentiles::of(std::iter::empty()), Percentiles::default());
    }
}
