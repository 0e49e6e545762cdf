//! The newest certificates, for those who ask for a proof.

use ledger_light::Certificate;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;

/// Most certificates that are kept. At five a second they last for three minutes.
const RECENT_MAX: usize = 1024;
/// How long a certificate is waited for: a majority of the voters is one exchange of messages away.
const PATIENCE: Duration = Duration::from_secs(2);

/// Certificates by height.
pub(super) struct Recent {
    certificates: Mutex<BTreeMap<u64, Certificate>>,
    added: watch::Sender<u64>,
}

impl Default for Recent {
    fn default() -> Self {
        Self { certificates: Mutex::default(), added: watch::Sender::new(0) }
    }
}

impl Recent {
    /// Keeps one. The oldest of too many makes room.
    pub(super) fn add(&self, certificate: Certificate) {
        let height = certificate.statement.height;
        let mut certificates = self.lock();
        certificates.insert(height, certificate);
        if certificates.len() > RECENT_MAX {
            certificates.pop_first();
        }
        drop(certificates);
        self.added.send_replace(height);
    }

    /// Notices each certificate that is added.
    pub(super) fn added(&self) -> watch::Receiver<u64> {
        self.added.subscribe()
    }

    /// The newest.
    pub(super) fn newest(&self) -> Option<Certificate> {
        self.lock().last_key_value().map(|(_, certificate)| certificate.clone())
    }

    /// The one of the block at a height.
    pub(super) fn of(&self, height: u64) -> Option<Certificate> {
        self.lock().get(&height).cloned()
    }

    /// The first one of a block at or after a height.
    pub(super) fn at_or_after(&self, height: u64) -> Option<Certificate> {
        self.lock().range(height..).next().map(|(_, certificate)| certificate.clone())
    }

    /// Waits until there is one of a block at or after a height; gives up if that takes too long.
    pub(super) async fn wait_from(&self, height: u64) {
        let mut added = self.added.subscribe();
        let found = async {
            while self.at_or_after(height).is_none() {
                added.changed().await.ok()?;
            }
            Some(())
        };
        let _perhaps_not = timeout(PATIENCE, found).await;
    }

    /// The one of a block, once there is one; none if that takes too long, or if those that are kept are newer.
    pub(super) async fn wait_for(&self, height: u64) -> Option<Certificate> {
        let mut added = self.added.subscribe();
        let found = async {
            loop {
                added.borrow_and_update();
                let known = {
                    let kept = self.lock();
                    let is_past =
                        kept.len() >= RECENT_MAX && kept.first_key_value().is_some_and(|(first, _)| height < *first);
                    if is_past { Some(None) } else { kept.get(&height).cloned().map(Some) }
                };
                if let Some(known) = known {
                    return known;
                }
                added.changed().await.ok()?;
            }
        };
        timeout(PATIENCE, found).await.ok()?
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<u64, Certificate>> {
        self.certificates.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;
    use ledger_light::Statement;

    fn certificate(height: u64) -> Certificate {
        let statement =
            Statement { network: Hash::ZERO, recoveries: 0, height, time: 1, block: Hash::ZERO, results: Hash::ZERO };
        Certificate { statement, signatures: Vec::new() }
    }

    #[tokio::test]
    async fn a_certificate_is_waited_for_and_the_oldest_of_too_many_makes_room() {
        let recent = Recent::default();
        let later = async {
            tokio::task::yield_now().await;
            (1..=RECENT_MAX as u64 + 2).for_each(|height| recent.add(certificate(height)));
        };
        let (found, ()) = tokio::join!(recent.wait_for(1000), later);
        assert_eq!(found.map(|found| found.statement.height), Some(1000));
        assert_eq!(recent.lock().keys().next(), Some(&3), "the oldest ones are gone");
        assert_eq!(recent.newest().map(|found| found.statement.height), Some(RECENT_MAX as u64 + 2));
    }
}
