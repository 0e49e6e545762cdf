//! From the half of a route of calls that comes from the ledger to the half at the local graph, in one order.

use std::time::Duration;

use ledger_base::hash::Hash;
use ledger_gate::gate::Passed;
use tokio::sync::{mpsc, watch};

use crate::graph::dds::Matched;

/// Most calls of a route without a reply, and most that wait to be handed over.
pub(in crate::routes) const CALLS_MAX: usize = 64;
/// The name of the reason for what is dropped because too many calls wait.
pub(in crate::routes) const TOO_MANY: &str = "too_many_calls";

/// A thing that is handed over.
#[derive(Debug)]
pub(in crate::routes) enum Handed {
    /// A message that has passed the gate.
    Passed(Passed),
    /// The robot is to stop, for this reason.
    Stop(&'static str),
}

/// News about a message that goes to the ledger, by its number.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::routes) enum SubmitUpdate {
    /// It goes in this transaction.
    Submitted(u64, Hash),
    /// The ledger has refused it.
    Refused(u64),
}

/// Hands over.
pub(in crate::routes) struct Hand {
    to: mpsc::Sender<Handed>,
    /// Those at the other end of the graph.
    matched: Matched,
    /// After how many messages the robot rested last. None where a message is done when it is handed over.
    rests: Option<watch::Receiver<u64>>,
    /// How many messages were handed over.
    handed: u64,
    /// Silence of the ledger after which the robot is to stop; none = the usual one.
    stale_after: Option<Duration>,
}

impl Hand {
    /// For calls, each of which is done when it is made.
    pub(in crate::routes) fn new(matched: Matched) -> (Self, mpsc::Receiver<Handed>) {
        let (to, from) = mpsc::channel(CALLS_MAX);
        (Self { to, matched, rests: None, handed: 0, stale_after: None }, from)
    }

    /// For calls that move the robot until it says that it rests, by the number of messages that it knows of. It is told of
    /// stops, and of one after `stale_after` without the ledger.
    pub(in crate::routes) fn until_rest(
        matched: Matched,
        stale_after: Duration,
    ) -> (Self, mpsc::Receiver<Handed>, watch::Sender<u64>) {
        let ((hand, from), (rests, rest)) = (Self::new(matched), watch::channel(0));
        (Self { rests: Some(rest), stale_after: Some(stale_after), ..hand }, from, rests)
    }

    pub(in crate::routes) fn stale_after(&self) -> Option<Duration> {
        self.stale_after
    }

    pub(in crate::routes) fn matched(&self) -> &Matched {
        &self.matched
    }

    /// Hands a message over; false if too many wait.
    pub(in crate::routes) fn give(&mut self, passed: Passed) -> bool {
        let has_room = self.to.try_send(Handed::Passed(passed)).is_ok();
        self.handed = self.handed.saturating_add(u64::from(has_room));
        has_room
    }

    /// Tells of a stop where that is of use: true if so. It is never left out.
    pub(in crate::routes) async fn stop(&self, reason: &'static str) -> bool {
        // An error means that the other half has ended, and has stopped what it moved.
        self.rests.is_some() && self.to.send(Handed::Stop(reason)).await.is_ok()
    }

    /// Has everything that was handed over been done?
    pub(in crate::routes) fn is_done(&self) -> bool {
        self.rests.as_ref().is_none_or(|rests| *rests.borrow() == self.handed)
    }

    /// Waits until everything has been done.
    pub(in crate::routes) fn done(&self) -> impl Future<Output = ()> + use<> {
        let (rests, handed) = (self.rests.clone(), self.handed);
        async move {
            // An error means that the other half has ended.
            let Some(mut rests) = rests else { return std::future::pending().await };
            if rests.wait_for(|known| *known == handed).await.is_err() {
                std::future::pending().await
            }
        }
    }
}
