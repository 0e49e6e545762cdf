//! The state that a route keeps besides its samples: the last ones of a latched topic, and the content key of a confidential service.

use std::time::Instant;

use ledger_api::v1::Delivery;
use ledger_base::rejection::Rejection;

use super::{ToLedger, outcome::LEFT_OUT};
use crate::{
    graph::queue::Incoming,
    log::one_line,
    routes::submission::{
        latch::{BYTES_MAX, SAMPLES_MAX},
        own_grant::OwnGrant,
    },
};

impl ToLedger {
    /// Keeps a sample of a latched topic until all are said, and tells of those that are left out. Gives any other sample back.
    pub(super) fn keep(&mut self, incoming: Incoming) -> Option<Incoming> {
        let Some(latch) = self.latch.as_mut().filter(|_| self.inlet.is_latched()) else { return Some(incoming) };
        let now = Instant::now();
        let left_out = latch.keep(incoming, now);
        self.counters.lock().live.came = Some(now);
        if left_out > 0 {
            let why = format!(
                "a call of a latched topic has room for {SAMPLES_MAX} samples and {BYTES_MAX} bytes: not for all"
            );
            self.drops(LEFT_OUT, left_out, why, now);
        }
        None
    }

    /// A content key was shared, or not: then says why.
    pub(super) fn shared(&mut self, made: Result<(), Rejection>) {
        if let Err(refused) = made
            && let Some(not_logged) = self.log_limiter.admit("share", Instant::now())
        {
            let service = &self.grant.service;
            tracing::warn!(
                service,
                code = refused.code.name(),
                reason = one_line(&refused),
                not_logged,
                "no content key can be shared"
            );
        }
    }

    /// A reader that comes or goes needs another key, and so does a grant that has just begun. `held` is the epoch before.
    pub(super) fn hear_of_readers(&mut self, delivery: &Delivery, held: u64) {
        let OwnGrant { epoch, .. } = self.grant;
        if delivery.events.iter().any(|event| event.name == "reader") || epoch != held && epoch > 0 {
            self.keys.renew_if_confidential(&self.grant);
        }
    }
}
