//! Which samples go out, and how those did that went.

use std::time::{Instant, SystemTime};

use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_traces::{Step, wall};

use super::ToLedger;
use crate::{
    graph::queue::Incoming,
    log::one_line,
    routes::{counters::count, ends::SubmitUpdate},
};

/// The name of the reason for a command that has waited here for too long.
pub(in crate::routes) const TOO_OLD: &str = "too_old";
/// The name of the reason for samples of a latched topic that no call has room for.
pub(in crate::routes) const LEFT_OUT: &str = "left_out";

/// The outcome of samples that were submitted together.
pub(super) struct Outcome {
    /// The number of the first one.
    pub(super) first: u64,
    /// When each was taken in.
    pub(super) received: Vec<Instant>,
    /// In which transaction, if it could be signed, and when it was on its way.
    pub(super) submitted: (Option<Hash>, Instant),
    pub(super) bytes: usize,
    /// The content key under which they were encrypted.
    pub(super) key: Option<u64>,
    pub(super) verdict: Result<(), Rejection>,
}

impl ToLedger {
    /// Tells the whole way of a message, and its part in this process.
    fn trace(&self, Outcome { received, submitted: (id, submitted), verdict, .. }: &Outcome) {
        let (Some(id), Some(first)) = (id, received.first()) else { return };
        let (service, tracer) = (&self.grant.service, &self.counters.tracer);
        tracer.tell(id, || Step {
            is_whole: true,
            failed: verdict.as_ref().err().map(|refused| refused.code.name()),
            ..Step::since("message", wall(*first)).with("ledgerd.service", service)
        });
        tracer.tell(id, || Step { ended: wall(*submitted), ..Step::since("submit", wall(*first)) });
    }

    /// Is a sample kept back, because the user holds no grant?
    pub(super) fn is_withheld(&mut self) -> bool {
        let withheld = self.withholds && self.grant.epoch == 0;
        if withheld {
            let mut counts = self.counters.lock();
            counts.summary.samples_in += 1;
            counts.summary.withheld += 1;
            counts.live.came = Some(Instant::now());
        }
        withheld
    }

    /// Has a command waited for longer than the robot's gate would let it pass? It is dropped then: its age counts from the
    /// signature on.
    pub(super) fn is_too_old(&mut self, incoming: &Incoming) -> bool {
        let now = Instant::now();
        let age = incoming.age(now, SystemTime::now());
        let Some(max_age) = self.max_age.filter(|max_age| age > *max_age) else { return false };
        let (age, max_age) = (age.as_millis(), max_age.as_millis());
        self.counters.lock().summary.samples_in += 1;
        self.drops(TOO_OLD, 1, format!("a command waited {age} ms to be signed, and is good for {max_age} ms"), now);
        true
    }

    /// Counts samples that were dropped here, and warns of it now and then.
    pub(super) fn drops(&mut self, name: &'static str, samples: u64, why: String, now: Instant) {
        if let Some(not_logged) = self.log_limiter.admit(name, now) {
            let service = &self.grant.service;
            tracing::warn!(service, reason = name, not_logged, "{why}");
        }
        let mut counts = self.counters.lock();
        count(&mut counts.summary.gate, name, samples);
        counts.live.came = Some(now);
        counts.live.refused = Some((name, why, now));
    }

    /// May the sample be submitted, and can it be a message of the route's type? One that cannot is counted as refused here.
    pub(super) fn fits(&mut self, incoming: &Incoming) -> bool {
        if self.is_withheld() || self.is_too_old(incoming) {
            return false;
        }
        let Err(refused) = self.check.check(&incoming.sample) else { return true };
        let now = Instant::now();
        let mut counts = self.counters.lock();
        counts.summary.samples_in += 1;
        counts.live.came = Some(now);
        drop(counts);
        self.refused(&refused, 1, now, "samples do not fit the type");
        false
    }

    /// Counts samples that were refused, and warns of it now and then.
    fn refused(&mut self, refused: &Rejection, samples: u64, now: Instant, what: &'static str) {
        let code = refused.code.name();
        let mut counts = self.counters.lock();
        count(&mut counts.summary.refused, code, samples);
        counts.live.refused = Some((code, one_line(refused), now));
        drop(counts);
        if let Some(not_logged) = self.log_limiter.admit(code, now) {
            let service = &self.grant.service;
            tracing::warn!(service, code, reason = one_line(refused), not_logged, "{what}");
        }
    }

    /// Counts an outcome. True if the own grant seems to be another than is known.
    pub(super) fn note(&mut self, outcome: Outcome) -> bool {
        self.trace(&outcome);
        let Outcome { first, received, bytes, key, verdict, .. } = outcome;
        self.under_way_bytes = self.under_way_bytes.saturating_sub(bytes);
        if verdict.is_err() {
            self.tell(SubmitUpdate::Refused(first));
        }
        let now = Instant::now();
        let refused = match verdict {
            Ok(()) => {
                let mut counts = self.counters.lock();
                for taken in received {
                    counts.committed(now.saturating_duration_since(taken));
                }
                return false;
            }
            Err(refused) => refused,
        };
        if let Some(latch) = &mut self.latch {
            latch.refused(now);
        }
        self.refused(&refused, received.len() as u64, now, "the ledger refuses samples");
        self.keys.refused(&self.grant, &refused, key);
        matches!(refused.code, Code::NotHolder | Code::StaleEpoch | Code::StaleSequence)
    }
}
