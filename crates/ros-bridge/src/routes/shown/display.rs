//! The holders on the topic of a route to the ledger. No gate asks there how the robot stands. So this asks, whenever the node
//! tells of something that may have changed it.

use std::{
    collections::BTreeSet,
    sync::Arc,
    time::{Duration, Instant},
};

use futures::StreamExt;
use ledger_api::Subscription;
use ledger_gate::{ABAC, service::Service};
use tokio::time::sleep_until;

use super::holder::HolderTopic;
use crate::{
    ledger::{
        gateway::{Deliveries, Gateway},
        robot_state::{Answer, Question, RobotStateQuery},
    },
    log::{LogLimiter, one_line},
};

/// A question without an answer is asked again after this time.
const AGAIN: Duration = Duration::from_secs(2);
/// The events after which the robot may stand otherwise.
const NEWS: [&str; 5] = ["granted", "released", "robot", "stopped", "resumed"];

/// The topic, and who is asked what it shows.
pub(in crate::routes) struct HolderDisplay {
    holder: HolderTopic,
    question: Question,
    service: String,
    events: Deliveries,
    log_limiter: LogLimiter,
}

impl HolderDisplay {
    /// Hears what changes from that height on.
    pub(in crate::routes) fn new(
        holder: HolderTopic,
        gateway: &dyn Gateway,
        (query, service): (Arc<RobotStateQuery>, &Service),
        from_height: u64,
    ) -> Self {
        let events = gateway.subscribe(Subscription {
            from_height,
            chaincode: ABAC.to_owned(),
            subjects: vec![service.service.clone(), service.robot.clone()],
            names: NEWS.map(str::to_owned).to_vec(),
            ..Subscription::default()
        });
        Self {
            holder,
            question: Question::new(query),
            service: service.service.clone(),
            events,
            log_limiter: LogLimiter::default(),
        }
    }

    /// Shows the holders as long as the route runs.
    pub(in crate::routes) async fn beside(self, route: impl Future<Output = ()>) {
        tokio::select! {
            biased;
            () = route => {}
            () = self.run() => {}
        }
    }

    async fn run(mut self) {
        self.question.ask(Instant::now(), BTreeSet::new());
        let mut due = None;
        loop {
            let (rests, again) = (!self.question.is_under_way(), due.unwrap_or_else(Instant::now));
            tokio::select! {
                biased;
                Some(delivery) = self.events.next() => {
                    if delivery.is_ok_and(|delivery| !delivery.events.is_empty()) {
                        due = Some(Instant::now());
                    }
                }
                answer = self.question.answer() => {
                    if !self.show(answer) {
                        due = due.or_else(|| Instant::now().checked_add(AGAIN));
                    }
                }
                () = sleep_until(again.into()), if rests && due.is_some() => {
                    self.question.ask(Instant::now(), BTreeSet::new());
                    due = None;
                }
            }
        }
    }

    /// Shows an answer; false if there is none.
    fn show(&mut self, answer: Answer) -> bool {
        match answer {
            Ok(answered) => {
                self.holder.show(&self.service, &answered.standing);
                true
            }
            Err(refused) => {
                if let Some(not_logged) = self.log_limiter.admit(refused.code.name(), Instant::now()) {
                    let (service, code, reason) = (&self.service, refused.code.name(), one_line(&refused));
                    tracing::warn!(service, code, reason, not_logged, "the voters do not confirm who holds {service}");
                }
                false
            }
        }
    }
}
