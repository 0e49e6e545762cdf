//! Endpoints on the other end: counted, so that callers wait on a condition instead of a time.

use std::time::{Duration, Instant};

use rtps::{
    guid::{Guid, GuidPrefix},
    io::Matches,
    qos::Policy,
};
use tokio::sync::watch;

use crate::log::LogLimiter;

/// By then a route has followed the quality of service of a subscriber that has come.
const FOLLOWED: Duration = Duration::from_secs(2);

/// The findings of discovery for one endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Matching {
    /// Endpoints of other participants that are matched now.
    pub matched: usize,
    /// Endpoints that were rejected so far because their quality of service does not fit.
    pub incompatible: u64,
}

/// Follows the matching of a reader or writer.
#[derive(Debug, Clone)]
pub struct Matched(watch::Receiver<Matches>);

impl Matched {
    pub(in crate::graph) fn of(matches: &watch::Receiver<Matches>) -> Self {
        Self(matches.clone())
    }

    /// The state now.
    pub fn now(&self) -> Matching {
        let matches = self.0.borrow();
        Matching { matched: matches.endpoints.len(), incompatible: matches.rejected }
    }

    /// Is this endpoint of another participant matched now?
    pub(super) fn has(&self, guid: Guid) -> bool {
        self.0.borrow().endpoints.contains(&guid)
    }

    /// The endpoints of one other participant that are matched now.
    pub(super) fn of_participant(&self, prefix: GuidPrefix) -> usize {
        self.0.borrow().endpoints.iter().filter(|guid| guid.prefix == prefix).count()
    }

    /// Waits for a change.
    ///
    /// # Errors
    /// If the reader or writer was closed.
    pub(super) async fn changed(&mut self) -> Result<(), watch::error::RecvError> {
        self.0.changed().await
    }

    /// Waits until at least `count` endpoints of others are matched; `false` if the reader or writer was closed
    /// before. It waits as long as it takes: put a timeout around it.
    pub async fn at_least(&self, count: usize) -> bool {
        self.0.clone().wait_for(|matches| matches.endpoints.len() >= count).await.is_ok()
    }

    /// Has DDS ended? Then nothing passes any more.
    pub fn is_ended(&self) -> bool {
        self.0.has_changed().is_err()
    }

    /// Waits until DDS ends, or the reader or writer is dropped.
    pub async fn ended(self) {
        let Self(mut matches) = self;
        while matches.changed().await.is_ok() {}
    }
}

/// Logs endpoints whose policies do not fit, each once.
pub(super) struct MismatchLog {
    topic: String,
    /// The words of the log, and the change that brings both together.
    message: &'static str,
    remedy: fn(Policy) -> &'static str,
    rejected: u64,
    log_limiter: LogLimiter,
}

impl MismatchLog {
    pub(super) fn new(topic: String, message: &'static str, remedy: fn(Policy) -> &'static str) -> Self {
        Self { topic, message, remedy, rejected: 0, log_limiter: LogLimiter::default() }
    }

    /// Looks at the findings of now.
    pub(super) fn look(&mut self, matches: &Matches) {
        if std::mem::replace(&mut self.rejected, matches.rejected) == matches.rejected {
            return;
        }
        for policy in matches.incompatible.values() {
            let (topic, message, remedy) = (&self.topic, self.message, (self.remedy)(*policy));
            let policy = policy.name();
            if let Some(not_logged) = self.log_limiter.admit(remedy, Instant::now()) {
                tracing::warn!(topic, policy, not_logged, "{message}: {remedy}");
            }
        }
    }
}

/// Logs the mismatches of a writer until it is closed, or DDS ends. The route may follow the subscribers by another writer; only a
/// mismatch that stays is logged.
pub(super) async fn watch_writer(mut matches: watch::Receiver<Matches>, mut log: MismatchLog) {
    while matches.changed().await.is_ok() {
        tokio::time::sleep(FOLLOWED).await;
        log.look(&matches.borrow_and_update());
    }
    tracing::error!(topic = log.topic, "DDS has ended: no sample is written any more");
}
