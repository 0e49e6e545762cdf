//! The account of a route of calls: what was handed over, and what has no reply and why.

use std::time::Instant;

use ledger_identity::{Identity, Role};

use crate::{
    error::{Error, Result},
    log::LogLimiter,
    routes::counters::{Counters, count},
};

/// Counts for the summary, and tells the log.
pub(in crate::routes) struct Account {
    service: String,
    counters: Counters,
    log_limiter: LogLimiter,
}

impl Account {
    pub(in crate::routes) fn new(service: &str, counters: Counters) -> Self {
        Self { service: service.to_owned(), counters, log_limiter: LogLimiter::default() }
    }

    /// Something was handed over to somebody in the local graph, or could not be. Returns what that led to.
    pub(in crate::routes) fn handed_over<T>(&mut self, what: &'static str, outcome: Result<T>) -> Option<T> {
        match outcome {
            Ok(done) => {
                let mut counts = self.counters.lock();
                counts.summary.published += 1;
                counts.live.passed = Some(Instant::now());
                return Some(done);
            }
            Err(Error::Unserved(explained)) => self.refuse("no_server", &explained.what),
            Err(error) => {
                self.counters.lock().summary.unpublished += 1;
                if let Some(not_logged) = self.log_limiter.admit("unpublished", Instant::now()) {
                    tracing::warn!(service = self.service, %error, not_logged, "{what} was not handed over");
                }
            }
        }
        None
    }

    /// A newer message has replaced so many.
    pub(in crate::routes) fn thinned(&self, count: u64) {
        self.counters.lock().summary.thinned += count;
    }

    /// A call has no reply, for this reason.
    pub(in crate::routes) fn refuse(&mut self, name: &'static str, meaning: &str) {
        let now = Instant::now();
        let mut counts = self.counters.lock();
        count(&mut counts.summary.gate, name, 1);
        counts.live.refused = Some((name, meaning.to_owned(), now));
        drop(counts);
        if let Some(not_logged) = self.log_limiter.admit(name, now) {
            tracing::warn!(service = self.service, reason = name, meaning, not_logged, "a call has no reply");
        }
    }

    /// Refuses a reply that another than the robot has signed; false if it was the robot. The gate has checked that the signer's
    /// organisation owns it.
    pub(in crate::routes) fn refuses(&mut self, creator: &Identity, robot: &str) -> bool {
        let is_robot = creator.role == Role::Robot && creator.name == robot;
        if !is_robot {
            let meaning = format!("{}, role {}, has signed a reply of {robot}", creator.id(), creator.role);
            self.refuse("not_the_robot", &meaning);
        }
        !is_robot
    }

    /// May requests go out: is the service held, or does it need no grant?
    pub(in crate::routes) fn may_call(&self) -> bool {
        let counts = self.counters.lock();
        counts.live.held || !counts.live.needs_grant
    }
}
