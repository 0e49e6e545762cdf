//! The reports of a bridge about itself while it runs: on the log, as text or as JSON.
//!
//! One line says that it is ready, and one tells each route. Further lines tell publishers and subscribers on its
//! topics that come and leave, and a node that is lost or answers again. They tell why a route is silent, and that it
//! carries messages again. As long as something is refused, they show the counters. All of it is limited in rate.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant, SystemTime},
};

use ledger_api::Context;
use tokio::{
    sync::mpsc,
    time::{MissedTickBehavior, interval},
};

use super::{
    diagnostics::{Diagnostics, Level, State, Status},
    neighbourhood::Neighbourhood,
    rogue_publishers::RoguePublisherReports,
    silence::silence,
    silence_log::Teller,
};
use crate::{
    config::Config,
    graph::{
        domain::{ChosenBy, Domain},
        local::LocalGraph,
        reach::Reach,
    },
    ledger::gateway::Gateway,
    log::one_line,
    routes::{
        counters::{RouteSummary, Tally},
        silence::{Facts, Silence},
        table::{OpenRoute, Roster},
    },
    shutdown::{Shutdown, requested},
};

/// Between two looks at the routes.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Silence of the ledger after which the node counts as lost: it gives a sign of life four times a second.
const LOST_AFTER: Duration = Duration::from_secs(2);

/// How the ledger and each route do, as it was at the last look. Clones share it.
#[derive(Clone, Default)]
pub(crate) struct Statuses(Arc<Mutex<Vec<Status>>>);

impl Statuses {
    /// As it was at the last look.
    pub(crate) fn now(&self) -> Vec<Status> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set(&self, statuses: Vec<Status>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = statuses;
    }
}

/// Reports on a running bridge until it ends.
pub(crate) struct Reporter {
    gateway: Arc<dyn Gateway>,
    local: LocalGraph,
    every: Duration,
    roster: Arc<Roster>,
    /// By the numbers of the routes.
    tellers: BTreeMap<usize, Teller>,
    /// Address of the node that answers.
    node: String,
    heard: Instant,
    is_lost: bool,
    /// Was there a participant in the local graph that cannot be reached?
    had_unreachable: bool,
    /// The counters at the last look, by the numbers of the routes.
    counted: BTreeMap<usize, RouteSummary>,
    diagnostics: Option<Diagnostics>,
    statuses: Statuses,
}

impl Reporter {
    /// Says that the bridge is ready, and what it carries.
    pub(crate) async fn ready(
        config: &Config,
        context: &Context,
        (domain, reach): (Domain, &Reach),
        gateway: Arc<dyn Gateway>,
        local: LocalGraph,
        roster: Arc<Roster>,
    ) -> Self {
        let node = gateway.node();
        let Domain { id, chosen_by } = domain;
        let identity = format!("{}/{}", context.organisation, context.name);
        let (name, shared_memory, count) = (&config.node_name, config.shared_memory, roster.slots().len());
        tracing::info!(
            context = context.name,
            organisation = context.organisation,
            node,
            domain = id,
            domain_from = chosen_by.to_string(),
            reach = reach.to_string(),
            node_name = name,
            shared_memory,
            routes = count,
            "the bridge of {identity} is ready: ROS domain {id} (from {chosen_by}), {reach}, node {node}"
        );
        if chosen_by == ChosenBy::Default {
            tracing::info!(
                domain = id,
                "no domain_id is set: every ROS 2 node without ROS_DOMAIN_ID is in this domain too"
            );
        }
        roster.open().for_each(|open| open.tell());
        let counted = roster.slots().iter().map(|slot| (slot.number, slot.summary())).collect();
        let (heard, every) = (Instant::now(), config.report_every);
        let diagnostics = if config.diagnostics {
            let opened = Diagnostics::open(&**local.middleware(), &config.node_name, &identity).await;
            opened
                .inspect_err(|refused| {
                    tracing::warn!(code = refused.code.name(), reason = one_line(refused), "there are no diagnostics")
                })
                .ok()
        } else {
            None
        };
        Self {
            gateway,
            local,
            every,
            roster,
            tellers: BTreeMap::new(),
            node,
            heard,
            is_lost: false,
            had_unreachable: false,
            counted,
            diagnostics,
            statuses: Statuses::default(),
        }
    }

    /// Where it says how the ledger and the routes do.
    pub(crate) fn statuses(&self) -> &Statuses {
        &self.statuses
    }

    /// Runs until it is told to end.
    pub(crate) async fn run(mut self, mut shutdown: Shutdown) {
        let (tell, mut changes) = mpsc::unbounded_channel();
        // Nobody hears it only when this task ends.
        let report = Box::new(move |change| drop(tell.send(change)));
        let mut follow = self.local.middleware().follow(self.roster.topics(), report);
        let mut neighbourhood = Neighbourhood::new(self.local.clone(), Arc::clone(&self.roster));
        let mut rogue_publishers = RoguePublisherReports::new(Arc::clone(&self.gateway));
        let mut look = interval(LOOK_EVERY);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut count = interval(self.every);
        count.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = requested(&mut shutdown) => return,
                Some(change) = changes.recv() => {
                    let now = Instant::now();
                    neighbourhood.note(change, now);
                    self.look_at_publishers(&mut rogue_publishers, now);
                }
                () = rogue_publishers.step() => {}
                _ = count.tick() => self.count(),
                _ = look.tick() => {
                    let now = Instant::now();
                    neighbourhood.look(now);
                    self.look_at_publishers(&mut rogue_publishers, now);
                    self.look_at_node(now);
                    self.look_at_routes(&neighbourhood, now);
                }
                () = &mut follow => {}
            }
        }
    }

    fn look_at_publishers(&self, rogue_publishers: &mut RoguePublisherReports, now: Instant) {
        self.roster.open().for_each(|open| rogue_publishers.look(&open, now));
    }

    fn look_at_node(&mut self, now: Instant) {
        let before = self.heard;
        self.heard = self.roster.last_heard().unwrap_or(before).max(before);
        let (node, silent) = (self.gateway.node(), now.saturating_duration_since(self.heard));
        match (self.is_lost, silent > LOST_AFTER) {
            (false, true) => {
                self.is_lost = true;
                let silent_ms = silent.as_millis();
                tracing::warn!(
                    node = self.node,
                    silent_ms,
                    "node {} lost: the ledger gives no sign of life",
                    self.node
                );
            }
            (true, false) => {
                self.is_lost = false;
                let lost_ms = self.heard.saturating_duration_since(before).as_millis();
                tracing::warn!(node, was = self.node, lost_ms, "connected to node {node}: the ledger is back");
                self.node = node;
            }
            (false, false) if node != self.node => {
                tracing::info!(node, was = self.node, "connected to node {node} instead of {}", self.node);
                self.node = node;
            }
            _ => {}
        }
    }

    /// Tells what is new about each route, and how they all do.
    /// That of the local graph, since a participant in it could not be reached.
    fn status_of_graph(&mut self) -> Option<Status> {
        let hosts = self.local.middleware().unreachable();
        self.had_unreachable |= !hosts.is_empty();
        self.had_unreachable.then(|| Status::of_graph(&hosts))
    }

    fn look_at_routes(&mut self, neighbourhood: &Neighbourhood, now: Instant) {
        let mut statuses = vec![self.status_of_node()];
        statuses.extend(self.status_of_graph());
        for slot in self.roster.slots() {
            let (summary, holder) = (slot.counters.summary(), slot.counters.lock().live.holder.clone());
            let status = match (slot.open(), self.is_lost) {
                (None, _) => {
                    let reason = slot.waits().map_or_else(String::new, |reason| one_line(&reason));
                    Status::of_route(&summary, String::new(), State::Waits(&reason))
                }
                // It is said why.
                (Some(_), true) => Status::of_route(&summary, holder, State::Unknown),
                (Some(open), false) => {
                    let silence = self.look_at_route(&open, neighbourhood, now);
                    let unreachable = neighbourhood.other_end(&open).unreachable;
                    let state = match slot.counters.lock().live.beside {
                        _ if unreachable > 0 => State::Unreachable {
                            others: unreachable,
                            role: slot.route.kind.other_end,
                            topic: open.topic().as_str(),
                        },
                        0 => silence.as_ref().map_or(State::Works, State::Silent),
                        others => State::NearbyEndpoint { others, topic: open.topic().as_str() },
                    };
                    Status::of_route(&summary, holder, state)
                }
            };
            statuses.push(status);
        }
        if let Some(diagnostics) = &self.diagnostics {
            diagnostics.publish(&statuses, SystemTime::now());
        }
        self.statuses.set(statuses);
    }

    fn look_at_route(&mut self, open: &OpenRoute, neighbourhood: &Neighbourhood, now: Instant) -> Option<Silence> {
        let other_end = neighbourhood.other_end(open);
        let counts = open.slot.counters.lock();
        let facts =
            Facts { service: &open.slot.route.service, topic: open.topic().as_str(), other_end, live: &counts.live };
        let (silence, passed) = (silence(open.slot.route.kind, &facts, now), counts.live.passed);
        drop(counts);
        self.tellers.entry(open.slot.number).or_default().look(open, silence.as_ref(), passed, now);
        silence
    }

    fn status_of_node(&self) -> Status {
        let (level, message) = match self.is_lost {
            true => (Level::Error, format!("node {} lost: the ledger gives no sign of life", self.node)),
            false => (Level::Ok, format!("connected to node {}", self.node)),
        };
        Status { level, name: "ledger".to_owned(), message, values: vec![("node".to_owned(), self.node.clone())] }
    }

    /// One line for each route that refused, lost or slowed down something since the last time.
    fn count(&mut self) {
        for slot in self.roster.slots() {
            let now = slot.summary();
            let Some(before) = self.counted.insert(slot.number, now.clone()) else { continue };
            let since = |now: u64, before: u64| now.saturating_sub(before);
            let (refused, gate) = (grown(&now.refused, &before.refused), grown(&now.gate, &before.gate));
            let replaced = since(now.replaced, before.replaced);
            let returned = since(now.returned, before.returned);
            let unpublished = since(now.unpublished, before.unpublished);
            let clamped = since(now.clamped, before.clamped);
            if refused.is_empty() && gate.is_empty() && replaced + returned + unpublished + clamped == 0 {
                continue;
            }
            let (samples_in, committed) =
                (since(now.samples_in, before.samples_in), since(now.committed, before.committed));
            let published = since(now.published, before.published);
            tracing::warn!(
                service = now.service,
                seconds = self.every.as_secs(),
                samples_in,
                committed,
                refused,
                replaced,
                returned,
                published,
                clamped,
                unpublished,
                gate,
                "not everything passes"
            );
        }
    }
}

/// By how much each entry of a tally has grown, as text.
fn grown(now: &Tally, before: &Tally) -> String {
    let more = now.iter().map(|(name, count)| (name, count.saturating_sub(before.get(name).copied().unwrap_or(0))));
    let more = more.filter(|(_, count)| *count > 0).map(|(name, count)| format!("{name} {count}"));
    more.collect::<Vec<_>>().join(", ")
}
