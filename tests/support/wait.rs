//! Waiting for conditions, never for time; random numbers that a failure can name.

use std::future::Future;
use std::time::{Duration, Instant};
use testkit::Random;

/// Far longer than anything here takes, also on a loaded machine: reaching it means that it never happens.
pub const PATIENCE: Duration = Duration::from_secs(60);
/// Between two looks.
const LOOK: Duration = Duration::from_millis(10);

/// Waits until the condition answers; panics with `what` if it never does.
pub async fn until<T, F: Future<Output = Option<T>>>(what: &str, mut look: impl FnMut() -> F) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look().await {
            return found;
        }
        assert!(Instant::now() < deadline, "never happened: {what}");
        tokio::time::sleep(LOOK).await;
    }
}

/// As [`until`], without a runtime.
pub fn eventually<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "never happened: {what}");
        std::thread::sleep(LOOK);
    }
}

/// Random numbers from a seed, so that the faults of a failed test can be told.
pub struct Dice(Random);

impl Dice {
    /// The seed in `LEDGERD_TEST_SEED`, else a new one; printed either way.
    pub fn roll(test: &str) -> Self {
        let given = std::env::var("LEDGERD_TEST_SEED").ok().map(|seed| seed.parse().expect("a number as seed"));
        let seed = given.unwrap_or_else(|| {
            let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
            now.as_nanos() as u64
        });
        println!("{test}: LEDGERD_TEST_SEED={seed}");
        Self(Random::seeded(seed))
    }

    /// A number below `limit`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0.below(limit)
    }

    /// So many random bytes.
    pub fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.below(256) as u8).collect()
    }
}
