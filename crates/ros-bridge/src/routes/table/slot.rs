//! A route that a bridge is to have, and whether it is open.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ledger_base::rejection::Rejection;
use ledger_traces::Tracer;
use rtps::qos::Qos as Policies;
use tokio::sync::watch;

use crate::{
    graph::{
        dds::{Exchange, Neighbour},
        mark::Mark,
        names::{Interface, TopicName},
        qos::Qos,
        shm::Peers,
    },
    log::one_line,
    routes::{
        counters::{Counters, RouteSummary},
        kind::RouteConfig,
    },
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
    Open(Arc<Opened>),
    /// The reason why it cannot be opened; none = nobody has tried yet.
    Waits(Option<Rejection>),
}

/// The findings of a route when it was opened.
pub(super) struct Opened {
    pub(super) topic: TopicName,
    pub(super) is_command: bool,
    pub(super) in_memory: Option<Peers>,
}

/// An open route.
#[derive(Clone)]
pub(crate) struct OpenRoute {
    /// Its configuration, and how it does.
    pub(crate) slot: Arc<Slot>,
    opened: Arc<Opened>,
}

impl Slot {
    /// A route that nobody has tried to open.
    pub(crate) fn new(number: usize, route: RouteConfig, mark: Mark, tracer: Tracer) -> Self {
        let counters = Counters::new(&route.service, route.kind.name).traced(tracer);
        let qos = watch::Sender::new(route.qos);
        Self { number, route, mark, counters, qos, state: Mutex::new(State::Waits(None)) }
    }

    /// The robot of its service.
    pub(crate) fn robot(&self) -> &str {
        self.route.service.split_once('/').map_or(&self.route.service, |(robot, _)| robot)
    }

    /// The open route.
    pub(crate) fn open(self: &Arc<Self>) -> Option<OpenRoute> {
        match &*self.lock() {
            State::Open(opened) => Some(OpenRoute { slot: Arc::clone(self), opened: Arc::clone(opened) }),
            State::Waits(_) => None,
        }
    }

    /// The counters, and why it is not open.
    pub(crate) fn summary(&self) -> RouteSummary {
        RouteSummary { waiting: self.waits().map(|reason| one_line(&reason)), ..self.counters.summary() }
    }

    /// The reason why it waits.
    pub(crate) fn waits(&self) -> Option<Rejection> {
        match &*self.lock() {
            State::Open(_) => None,
            State::Waits(reason) => reason.clone(),
        }
    }

    /// It is open now.
    pub(super) fn opened(&self, opened: Opened) {
        *self.lock() = State::Open(Arc::new(opened));
    }

    /// It waits now. True if the reason is another than before.
    pub(super) fn closed(&self, reason: &Rejection) -> bool {
        let before = std::mem::replace(&mut *self.lock(), State::Waits(Some(reason.clone())));
        !matches!(before, State::Waits(Some(before)) if (before.code, &before.message) == (reason.code, &reason.message))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl OpenRoute {
    /// The local topic.
    pub(crate) fn topic(&self) -> &TopicName {
        &self.opened.topic
    }

    /// Do users publish and the robot listens?
    pub(crate) fn is_command(&self) -> bool {
        self.opened.is_command
    }

    /// The other users of the topic in shared memory.
    pub(crate) fn in_memory(&self) -> Option<&Peers> {
        self.opened.in_memory.as_ref()
    }

    /// The DDS topic on which others meet this route: that of the requests if it carries calls, of the goals if it carries actions.
    pub(crate) fn dds_topic(&self) -> String {
        self.requests().map_or_else(|| self.topic().dds(), |exchange| exchange.requests())
    }

    /// The DDS type there.
    pub(crate) fn dds_type(&self) -> String {
        self.requests().map_or_else(|| self.slot.route.message.dds(), |exchange| exchange.request_type().dds())
    }

    fn requests(&self) -> Option<Exchange> {
        match self.slot.route.message.interface() {
            Interface::Message => None,
            Interface::Service => Some(Exchange::new(self.topic(), &self.slot.route.message)),
            Interface::Action => Exchange::of_goals(self.topic(), &self.slot.route.message).ok(),
        }
    }

    /// These are the endpoints at the other end now. Answers the quality of service that meets them, if that is another than
    /// before.
    pub(crate) fn meet(&self, others: &[&Neighbour]) -> Option<Qos> {
        if others.is_empty() {
            return None;
        }
        let RouteConfig { qos, copied, kind, .. } = &self.slot.route;
        let keyed = others.iter().all(|other| other.is_keyed());
        let policies: Vec<&Policies> = others.iter().map(|other| &other.qos).collect();
        let met = Qos { keyed, ..qos.meeting(*copied, kind.takes_in(), self.is_command(), &policies) };
        let is_news = self.slot.qos.send_if_modified(|known| std::mem::replace(known, met) != met);
        is_news.then_some(met)
    }

    /// Says what the route carries.
    pub(crate) fn tell(&self) {
        let (Slot { number, route, qos, .. }, topic) = (&*self.slot, self.topic());
        let (service, message, qos) = (&route.service, &route.message, *qos.borrow());
        let (direction, arrow) = (route.kind.name, route.kind.arrow(topic, service));
        let (reliability, durability) = (qos.reliability.name(), qos.durability.name());
        tracing::info!(
            service, direction, topic = topic.as_str(), r#type = %message, reliability, durability, depth = qos.depth,
            "route {number}: {arrow}"
        );
    }
}
