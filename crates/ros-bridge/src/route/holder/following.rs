//! The holders on the topic of a route to the ledger. No gate asks there how the robot stands. So this asks, whenever the node
//! tells of something that may have changed it.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::{FutureExt, StreamExt, future::BoxFuture};
use ledger_api::Subscription;
use ledger_gate::{ABAC, service::Service};
use tokio::time::sleep_until;

use super::Holder;
use crate::{
    count::{Complaint, line},
    gateway::{Deliveries, Gateway},
    standing::{Answer, Asker, answer},
};

/// A question without an answer is asked again after this time.
const AGAIN: Duration = Duration::from_secs(2);
/// The events after which the robot may stand otherwise.
const NEWS: [&str; 5] = ["granted", "released", "robot", "stopped", "resumed"];

/// The topic, and who is asked what it shows.
pub(in crate::route) struct Following {
    holder: Holder,
    asker: Arc<Asker>,
    service: String,
    events: Deliveries,
    complaint: Complaint,
}

impl Following {
    /// Hears what changes from that height on.
    pub(in crate::route) fn new(
        holder: Holder,
        gateway: &dyn Gateway,
        (asker, service): (Arc<Asker>, &Service),
        from_height: u64,
    ) -> Self {
        let events = gateway.subscribe(Subscription {
            from_height,
            chaincode: ABAC.to_owned(),
            subjects: vec![service.service.clone(), service.robot.clone()],
            names: NEWS.map(str::to_owned).to_vec(),
            ..Subscription::default()
        });
        Self { holder, asker, service: service.service.clone(), events, complaint: Complaint::default() }
    }

    /// Shows the holders as long as the route runs.
    pub(in crate::route) async fn beside(self, route: impl Future<Output = ()>) {
        tokio::select! {
            biased;
            () = route => {}
            () = self.run() => {}
        }
    }

    async fn run(mut self) {
        let mut question = Some(self.ask());
        let mut due = None;
        loop {
            let (rests, again) = (question.is_none(), due.unwrap_or_else(Instant::now));
            tokio::select! {
                biased;
                Some(delivery) = self.events.next() => {
                    if delivery.is_ok_and(|delivery| !delivery.events.is_empty()) {
                        due = Some(Instant::now());
                    }
                }
                answer = answer(&mut question) => {
                    if !self.show(answer) {
                        due = due.or_else(|| Instant::now().checked_add(AGAIN));
                    }
                }
                () = sleep_until(again.into()), if rests && due.is_some() => {
                    (question, due) = (Some(self.ask()), None);
                }
            }
        }
    }

    /// Asks how the robot stands now, or later.
    fn ask(&self) -> BoxFuture<'static, Answer> {
        let (asker, since) = (Arc::clone(&self.asker), Instant::now());
        async move { asker.ask(since).await }.boxed()
    }

    /// Shows an answer; false if there is none.
    fn show(&mut self, answer: Answer) -> bool {
        match answer {
            Ok(answered) => {
                self.holder.show(&self.service, &answered.standing);
                true
            }
            Err(refused) => {
                if let Some(not_logged) = self.complaint.worth(refused.code.name(), Instant::now()) {
                    let (service, code, reason) = (&self.service, refused.code.name(), line(&refused));
                    tracing::warn!(service, code, reason, not_logged, "the voters do not say who holds {service}");
                }
                false
            }
        }
    }
}
