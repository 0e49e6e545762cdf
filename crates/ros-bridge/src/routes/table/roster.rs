//! The routes of a bridge as they stand now: which carry messages, and what the others wait for.

use std::{
    collections::BTreeSet,
    fmt,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::Instant,
};

use ledger_base::rejection::Rejection;
use ledger_traces::Tracer;
use tokio::sync::watch;

use super::slot::{OpenRoute, Opened, Slot};
use crate::{
    graph::{mark::Mark, names::TopicName},
    routes::{
        counters::RouteSummary,
        kind::{RouteConfig, circle},
    },
};

/// Every route of a bridge.
#[derive(Default)]
pub(crate) struct Roster {
    slots: Mutex<Vec<Arc<Slot>>>,
    /// Routes so far: no number comes again.
    numbered: AtomicUsize,
    /// The DDS topics of the open routes.
    topics: watch::Sender<BTreeSet<String>>,
    /// When the ledger was last heard beside the routes.
    heard: Mutex<Option<Instant>>,
    /// Where the steps of messages are told.
    tracer: Tracer,
}

impl Roster {
    /// No route yet; the steps of messages are told there.
    pub(crate) fn traced(tracer: Tracer) -> Self {
        Self { tracer, ..Self::default() }
    }

    /// Takes a route in, with the next number.
    pub(crate) fn add(&self, route: RouteConfig, mark: Mark) -> Arc<Slot> {
        let number = self.numbered.fetch_add(1, Ordering::Relaxed).saturating_add(1);
        let slot = Arc::new(Slot::new(number, route, mark, self.tracer.clone()));
        self.lock().push(Arc::clone(&slot));
        slot
    }

    /// Forgets a route that has ended.
    pub(crate) fn remove(&self, number: usize) {
        self.lock().retain(|slot| slot.number != number);
        self.changed();
    }

    pub(crate) fn slots(&self) -> Vec<Arc<Slot>> {
        self.lock().clone()
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<Slot>>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The robots to which something is taken.
    pub(crate) fn robots(&self) -> BTreeSet<String> {
        self.slots().iter().filter(|slot| slot.route.kind.takes_in()).map(|slot| slot.robot().to_owned()).collect()
    }

    /// The services of a robot to which something is taken, and that ask for a grant, in order.
    pub(crate) fn held_services(&self, robot: &str) -> Vec<String> {
        let (is_own, needs_grant) = (self.taken(robot), |slot: &Slot| slot.counters.lock().live.needs_grant);
        let services: BTreeSet<String> =
            is_own.iter().filter(|slot| needs_grant(slot)).map(|slot| slot.route.service.clone()).collect();
        services.into_iter().collect()
    }

    /// Those of them that the bridge's identity holds now.
    pub(crate) fn held_now(&self, robot: &str) -> BTreeSet<String> {
        let held = |slot: &Slot| slot.counters.lock().live.held;
        self.taken(robot).iter().filter(|slot| held(slot)).map(|slot| slot.route.service.clone()).collect()
    }

    /// The routes that take something to a robot.
    fn taken(&self, robot: &str) -> Vec<Arc<Slot>> {
        self.slots().into_iter().filter(|slot| slot.route.kind.takes_in() && slot.robot() == robot).collect()
    }

    /// The ledger gave a sign of life, to nobody's route.
    pub(crate) fn heard(&self, now: Instant) {
        *self.heard.lock().unwrap_or_else(PoisonError::into_inner) = Some(now);
    }

    /// When the ledger last gave a sign of life.
    pub(crate) fn last_heard(&self) -> Option<Instant> {
        let beside = *self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        self.slots().iter().filter_map(|slot| slot.counters.lock().live.heard).chain(beside).max()
    }

    /// The open routes.
    pub(crate) fn open(&self) -> impl Iterator<Item = OpenRoute> {
        self.slots().into_iter().filter_map(|slot| slot.open())
    }

    /// The DDS topics of the open routes, from now on.
    pub(crate) fn topics(&self) -> watch::Receiver<BTreeSet<String>> {
        self.topics.subscribe()
    }

    pub(super) fn opened(&self, slot: &Slot, opened: Opened) {
        slot.opened(opened);
        self.changed();
    }

    /// True if the reason is another than before.
    pub(super) fn closed(&self, slot: &Slot, reason: &Rejection) -> bool {
        let is_new = slot.closed(reason);
        self.changed();
        is_new
    }

    fn changed(&self) {
        self.topics.send_replace(self.open().map(|watched| watched.dds_topic()).collect());
    }

    /// Refuses a route on this topic if, with an open one, each message would go round.
    pub(crate) fn no_circle(&self, slot: &Slot, topic: &TopicName) -> Result<(), Rejection> {
        let closes = |other: &OpenRoute| {
            other.slot.number != slot.number
                && other.slot.route.service == slot.route.service
                && other.topic() == topic
                && other.slot.route.kind.takes_in() != slot.route.kind.takes_in()
        };
        match self.open().find(|other| closes(other)) {
            Some(other) => {
                let both = [(other.slot.number, other.slot.route.kind), (slot.number, slot.route.kind)];
                Err(circle(&slot.route.service, topic.as_str(), both))
            }
            None => Ok(()),
        }
    }

    pub(crate) fn summaries(&self) -> Vec<RouteSummary> {
        self.slots().iter().map(|slot| slot.summary()).collect()
    }
}

impl fmt::Debug for Roster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.slots().iter().map(|slot| &slot.route.service)).finish()
    }
}
