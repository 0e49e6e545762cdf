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
use rustdds::QosPolicies;
use tokio::sync::watch;

use crate::{
    config::{RouteConfig, circle},
    count::{Counters, RouteSummary, line},
    dds::{Exchange, Neighbour},
    mark::Mark,
    names::{Interface, TopicName},
    qos::Qos,
    shm::Peers,
};

/// A configured route, whether it is open or not.
pub(crate) struct Slot {
    /// Its place in the configuration of the start, from 1; routes that come later have later ones.
    pub(crate) number: usize,
    pub(crate) route: RouteConfig,
    pub(crate) mark: Mark,
    /// They go on when the route is opened again.
    pub(crate) counters: Counters,
    /// The quality of service that meets the others on its topic.
    pub(crate) qos: watch::Sender<Qos>,
    state: Mutex<State>,
}

/// Is a route open?
enum State {
    Open(Arc<Watched>),
    /// The reason why it cannot be opened; none = nobody has tried yet.
    Waits(Option<Rejection>),
}

/// An open route.
pub(crate) struct Watched {
    /// As that of its slot.
    pub(crate) number: usize,
    pub(crate) route: RouteConfig,
    pub(crate) topic: TopicName,
    pub(crate) mark: Mark,
    /// Do users publish and the robot listens?
    pub(crate) is_command: bool,
    pub(crate) counters: Counters,
    /// The other users of the topic in shared memory.
    pub(crate) in_memory: Option<Peers>,
    /// The quality of service that meets the others on its topic: the route follows it.
    pub(crate) qos: watch::Sender<Qos>,
}

impl Slot {
    /// A route that nobody has tried to open.
    pub(crate) fn new(number: usize, route: RouteConfig, mark: Mark, tracer: Tracer) -> Self {
        let counters = Counters::new(&route).traced(tracer);
        let qos = watch::Sender::new(route.qos);
        Self { number, route, mark, counters, qos, state: Mutex::new(State::Waits(None)) }
    }

    /// The robot of its service.
    pub(crate) fn robot(&self) -> &str {
        self.route.service.split_once('/').map_or(&self.route.service, |(robot, _)| robot)
    }

    /// The open route.
    pub(crate) fn open(&self) -> Option<Arc<Watched>> {
        match &*self.lock() {
            State::Open(watched) => Some(Arc::clone(watched)),
            State::Waits(_) => None,
        }
    }

    /// The counters, and why it is not open.
    pub(crate) fn summary(&self) -> RouteSummary {
        RouteSummary { waiting: self.waits().map(|reason| line(&reason)), ..self.counters.summary() }
    }

    /// The reason why it waits.
    pub(crate) fn waits(&self) -> Option<Rejection> {
        match &*self.lock() {
            State::Open(_) => None,
            State::Waits(reason) => reason.clone(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Watched {
    /// The DDS topic on which others meet this route: that of the requests if it carries calls, of the goals if it carries actions.
    pub(crate) fn dds_topic(&self) -> String {
        self.requests().map_or_else(|| self.topic.dds(), |exchange| exchange.requests())
    }

    /// The DDS type there.
    pub(crate) fn dds_type(&self) -> String {
        self.requests().map_or_else(|| self.route.message.dds(), |exchange| exchange.request_type().dds())
    }

    fn requests(&self) -> Option<Exchange> {
        match self.route.message.interface() {
            Interface::Message => None,
            Interface::Service => Some(Exchange::new(&self.topic, &self.route.message)),
            Interface::Action => Exchange::of_goals(&self.topic, &self.route.message).ok(),
        }
    }

    /// These are the endpoints at the other end now. Answers the quality of service that meets them, if that is another than
    /// before.
    pub(crate) fn meet(&self, others: &[&Neighbour]) -> Option<Qos> {
        if others.is_empty() {
            return None;
        }
        let RouteConfig { qos, copied, kind, .. } = &self.route;
        let keyed = others.iter().all(|other| other.is_keyed());
        let policies: Vec<&QosPolicies> = others.iter().map(|other| &other.qos).collect();
        let met = Qos { keyed, ..qos.meeting(*copied, kind.takes_in(), self.is_command, &policies) };
        let is_news = self.qos.send_if_modified(|known| std::mem::replace(known, met) != met);
        is_news.then_some(met)
    }

    /// Says what the route carries.
    pub(crate) fn tell(&self) {
        let Self { number, route, topic, .. } = self;
        let (service, message, qos) = (&route.service, &route.message, *self.qos.borrow());
        let (direction, arrow) = (route.kind.name, route.kind.arrow(topic, service));
        let (reliability, durability) = (qos.reliability.name(), qos.durability.name());
        tracing::info!(
            service, direction, topic = topic.as_str(), r#type = %message, reliability, durability, depth = qos.depth,
            "route {number}: {arrow}"
        );
    }
}

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
    pub(crate) fn open(&self) -> impl Iterator<Item = Arc<Watched>> {
        self.slots().into_iter().filter_map(|slot| slot.open())
    }

    /// The DDS topics of the open routes, from now on.
    pub(crate) fn topics(&self) -> watch::Receiver<BTreeSet<String>> {
        self.topics.subscribe()
    }

    pub(crate) fn opened(&self, slot: &Slot, watched: Watched) {
        *slot.lock() = State::Open(Arc::new(watched));
        self.changed();
    }

    /// True if the reason is another than before.
    pub(crate) fn closed(&self, slot: &Slot, reason: &Rejection) -> bool {
        let before = std::mem::replace(&mut *slot.lock(), State::Waits(Some(reason.clone())));
        self.changed();
        !matches!(before, State::Waits(Some(before)) if (before.code, &before.message) == (reason.code, &reason.message))
    }

    fn changed(&self) {
        self.topics.send_replace(self.open().map(|watched| watched.dds_topic()).collect());
    }

    /// Refuses a route on this topic if, with an open one, each message would go round.
    pub(crate) fn no_circle(&self, slot: &Slot, topic: &TopicName) -> Result<(), Rejection> {
        let closes = |other: &Watched| {
            other.number != slot.number
                && other.route.service == slot.route.service
                && other.topic == *topic
                && other.route.kind.takes_in() != slot.route.kind.takes_in()
        };
        match self.open().find(|other| closes(other)) {
            Some(other) => {
                let both = [(other.number, other.route.kind), (slot.number, slot.route.kind)];
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
