//! Messages that passed go out: to the other half of a route of calls, or to the topic.

use std::time::Instant;

use ledger_gate::{gate::Passed, sample::Sample};
use ledger_traces::{Step, wall};

use super::FromLedger;
use crate::{
    graph::qos::Durability,
    routes::{counters::count, ends::TOO_MANY},
};

impl FromLedger {
    pub(super) fn publish(&mut self, passed: Passed) {
        if self.rogue_publishers.drops(&self.counters) {
            return;
        }
        let transaction = passed.transaction;
        if let Some(age_us) = passed.age_us {
            self.counters.lock().age.observe(age_us);
        }
        self.hand_out(passed);
        let step = || Step::since("deliver", wall(self.judged)).with("ledgerd.service", &self.route.service);
        self.counters.tracer.tell(&transaction, step);
    }

    fn hand_out(&mut self, passed: Passed) {
        if let Some(hand) = self.outputs.outlet.hand() {
            let mut counts = self.counters.lock();
            counts.live.came = Some(Instant::now());
            if !hand.give(passed) {
                count(&mut counts.summary.gate, TOO_MANY, 1);
            }
            if hand.is_done() {
                self.guard.rested();
            }
            return;
        }
        let Passed { samples, clamped, .. } = passed;
        self.stop_messages.driven();
        let mut counts = self.counters.lock();
        counts.live.came = Some(Instant::now());
        counts.summary.clamped = counts.summary.clamped.saturating_add(u64::try_from(clamped).unwrap_or(u64::MAX));
        if clamped > 0
            && let Some(not_logged) = self.log_limiter.admit("clamped", Instant::now())
        {
            let service = &self.route.service;
            tracing::warn!(service, not_logged, "the gate slowed a message down to the limit of its creator's grant");
        }
        drop(counts);
        for sample in samples {
            self.write_in_its_turn(sample);
        }
    }

    /// Writes a sample, unless the feed has a highest rate and it comes too soon. Commands are never late, nor left out. Nor are
    /// samples of a latched topic: each of its publishers says something else.
    fn write_in_its_turn(&mut self, sample: Sample) {
        if self.service.is_command() || self.outputs.qos.borrow().durability == Durability::TransientLocal {
            return self.write(&sample);
        }
        let passes = self.pace.offer(sample, Instant::now());
        self.counters.lock().summary.thinned += self.pace.thinned();
        if let Some(sample) = passes {
            self.write(&sample);
        }
    }

    /// Writes the sample that has waited for its turn.
    pub(super) fn write_paced(&mut self) {
        if let Some(sample) = self.pace.take(Instant::now()) {
            self.write(&sample);
        }
    }

    fn write(&mut self, sample: &Sample) {
        let written = self.outputs.outlet.write(sample);
        let mut counts = self.counters.lock();
        match written {
            Ok(()) => {
                counts.summary.published += 1;
                counts.live.passed = Some(Instant::now());
            }
            Err(error) => {
                counts.summary.unpublished += 1;
                if let Some(silent) = self.log_limiter.admit("unpublished", Instant::now()) {
                    tracing::warn!(service = self.route.service, %error, not_logged = silent, "message not published");
                }
            }
        }
    }
}
