//! The subscriptions of a route from the ledger.

use futures::{StreamExt, stream};
use ledger_api::Subscription;
use ledger_gate::{ABAC, MSP};

use super::FromLedger;
use crate::ledger::gateway::{Deliveries, HEARTBEAT_MS};

impl FromLedger {
    /// Subscribes to what the ledger tells; to nothing while nobody listens to a feed.
    pub(super) fn begin(&self) -> (Deliveries, Deliveries) {
        if !self.demand.is_there() {
            return (stream::pending().boxed(), stream::pending().boxed());
        }
        let revocations = self.gateway.subscribe(Subscription {
            from_height: self.next_height,
            chaincode: MSP.to_owned(),
            names: vec!["revoked".to_owned(), "revocation_list".to_owned()],
            heartbeat: HEARTBEAT_MS,
            ..Subscription::default()
        });
        (self.subscribe(), revocations)
    }

    /// Somebody listens, or nobody any more. Nobody told what changed meanwhile: nothing passes until the voters have.
    pub(super) fn begin_again(&mut self) -> (Deliveries, Deliveries) {
        self.next_height = 0;
        // No message waits: none came.
        let _none = self.guard.gone(self.clocks.now());
        if self.demand.is_there() && !self.question.is_under_way() {
            self.ask();
        }
        self.begin()
    }

    /// Subscribes to what the ledger tells of the service and its robot.
    pub(super) fn subscribe(&self) -> Deliveries {
        let tasks = if self.settings.points.is_empty() { &[][..] } else { &["task"] };
        let names = ["message", "keyed", "granted", "released", "robot", "stopped", "resumed"].iter().chain(tasks);
        self.gateway.subscribe(Subscription {
            from_height: self.next_height,
            chaincode: ABAC.to_owned(),
            subjects: vec![self.route.service.clone(), self.service.robot.clone()],
            names: names.map(|name| (*name).to_owned()).collect(),
            heartbeat: HEARTBEAT_MS,
            early: true,
            proofs: false,
            heads: true,
        })
    }
}
