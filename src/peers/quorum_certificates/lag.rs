//! How long certificates lag behind execution, and waiting for the one of a block.

use super::Certificates;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Without a certificate for longer than this, a network does not certify now, and waiting is of no use.
const LAG_MAX: Duration = Duration::from_secs(2);

/// Since when a block that is due has no certificate, and none has been added.
#[derive(Default)]
pub(super) struct Lag(Mutex<Option<Instant>>);

impl Lag {
    /// A block was executed that is due to be certified.
    pub(super) fn executed(&self, now: Instant) {
        self.since().get_or_insert(now);
    }

    /// A certificate was added. Is it that of the newest executed block?
    pub(super) fn certified(&self, is_newest: bool, now: Instant) {
        *self.since() = (!is_newest).then_some(now);
    }

    fn is_long(&self, now: Instant) -> bool {
        self.since().is_some_and(|since| now.saturating_duration_since(since) > LAG_MAX)
    }

    fn since(&self) -> MutexGuard<'_, Option<Instant>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Certificates {
    /// Waits at most `patience` until a block is certified, itself or with a later one; is it? Does not wait while the network
    /// certifies nothing.
    pub(crate) async fn reaches(&self, height: u64, patience: Duration) -> bool {
        let is_reached = || self.certified() >= height;
        if is_reached() || self.lag.is_long(Instant::now()) || patience.is_zero() {
            return is_reached();
        }
        let mut added = self.recent.added();
        let reached = async { while !is_reached() && added.changed().await.is_ok() {} };
        let _perhaps_not = tokio::time::timeout(patience, reached).await;
        is_reached()
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;
    use ledger_light::{Certificate, Statement};
    use std::sync::atomic::Ordering::Relaxed;

    /// Far longer than anything here takes.
    const LONG: Duration = Duration::from_secs(3600);

    #[test]
    fn certificates_lag_once_a_due_block_has_none_for_two_seconds() {
        let (lag, begun) = (Lag::default(), Instant::now());
        assert!(!lag.is_long(begun + LONG), "no block is due");
        lag.executed(begun);
        lag.executed(begun + LAG_MAX);
        assert!(!lag.is_long(begun + LAG_MAX));
        assert!(lag.is_long(begun + LAG_MAX + Duration::from_millis(1)), "the first block counts");
        // A certificate of an earlier block shows that the network certifies: the time begins again.
        lag.certified(false, begun + LAG_MAX);
        assert!(!lag.is_long(begun + 2 * LAG_MAX));
        assert!(lag.is_long(begun + 3 * LAG_MAX));
        lag.certified(true, begun + 3 * LAG_MAX);
        assert!(!lag.is_long(begun + LONG), "all that is due is certified");
    }

    #[tokio::test]
    async fn a_certificate_is_waited_for_but_not_while_the_network_certifies_nothing() {
        let data = tempfile::tempdir().unwrap();
        let (certificates, _events) = Certificates::open(data.path()).unwrap();
        assert!(certificates.reaches(0, LONG).await, "the genesis needs none");
        assert!(!certificates.reaches(7, Duration::ZERO).await);
        certificates.lag.executed(Instant::now());
        let (reached, ()) = tokio::join!(certificates.reaches(7, LONG), async {
            let (network, block, results) = (Hash::ZERO, Hash::ZERO, Hash::ZERO);
            for height in [6, 8] {
                tokio::task::yield_now().await;
                let statement = Statement { network, recoveries: 0, height, time: 1, block, results };
                certificates.certified.fetch_max(height, Relaxed);
                certificates.recent.add(Certificate { statement, signatures: Vec::new() });
            }
        });
        assert!(reached, "a later certificate covers the block");
        certificates.lag.certified(false, Instant::now().checked_sub(2 * LAG_MAX).unwrap());
        assert!(certificates.lag.is_long(Instant::now()));
        let waited = tokio::time::timeout(Duration::from_secs(60), certificates.reaches(9, LONG)).await;
        assert_eq!(waited, Ok(false), "it does not wait");
    }
}
