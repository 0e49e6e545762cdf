//! Random numbers of a seed: the same on every machine.

/// A stream of random numbers (SplitMix64). Two streams of one seed are told apart by their names.
#[derive(Clone, Debug)]
pub(crate) struct Noise {
    state: u64,
}

impl Noise {
    /// The stream of a seed.
    pub(crate) fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// A stream of its own for each name, from one seed.
    pub(crate) fn named(seed: u64, name: &str) -> Self {
        // FNV-1a: names need to differ, nothing more.
        let hash = name
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
        Self::new(seed ^ hash)
    }

    /// Another stream, by the next number of this one.
    pub(crate) fn fork(&mut self) -> Self {
        Self::new(self.next())
    }

    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.state ^ (self.state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// Between zero and one, one excluded.
    pub(crate) fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Of a normal distribution with mean zero and this deviation.
    pub(crate) fn normal(&mut self, deviation: f64) -> f64 {
        // Box-Muller; the logarithm of zero is avoided.
        let (radius, angle) = (1.0 - self.uniform(), self.uniform());
        deviation * (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
    }

    /// Of an exponential distribution with this mean.
    pub(crate) fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.uniform()).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(count: u32, mut draw: impl FnMut() -> f64) -> f64 {
        (0..count).map(|_| draw()).sum::<f64>() / f64::from(count)
    }

    #[test]
    fn a_seed_gives_the_same_numbers_and_each_name_others() {
        let draw = |mut noise: Noise| [noise.uniform(), noise.uniform()];
        assert_eq!(draw(Noise::named(1, "link")), draw(Noise::named(1, "link")));
        assert_ne!(draw(Noise::named(1, "link")), draw(Noise::named(1, "camera")));
        assert_ne!(draw(Noise::named(1, "link")), draw(Noise::named(2, "link")));
    }

    #[test]
    fn distributions_have_their_means() {
        let mut noise = Noise::new(3);
        assert!((mean(20_000, || noise.uniform()) - 0.5).abs() < 0.01);
        assert!((mean(20_000, || noise.exponential(2.0)) - 2.0).abs() < 0.06);
        assert!(mean(20_000, || noise.normal(1.0)).abs() < 0.03);
        assert!((mean(20_000, || noise.normal(1.0).powi(2)) - 1.0).abs() < 0.05);
    }
}
