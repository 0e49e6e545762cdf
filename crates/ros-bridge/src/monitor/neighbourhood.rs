//! The neighbours on the topics of a bridge, and their meaning for its routes.

mod budget;
mod meaning;
mod rogue;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Instant,
};

use tokio::task::AbortHandle;

use self::{
    budget::LogBudget,
    meaning::{Line, is_bridge, meaning, misfit},
    rogue::NearbyPublishers,
};
use crate::{
    graph::{
        dds::{Change, Neighbour},
        endpoint::Role,
        local::LocalGraph,
        names::{Interface, TopicName, quoted},
        qos::{Qos, Reliability},
        queue::Limits,
        shm::Peers,
    },
    routes::{
        silence::OtherEnd,
        table::{OpenRoute, Roster},
    },
};

/// Most publishers of other bridges that are listened to.
const LISTENED_MAX: usize = 16;

/// The known neighbours.
pub(crate) struct Neighbourhood {
    local: LocalGraph,
    roster: Arc<Roster>,
    known: BTreeMap<[u8; 16], Neighbour>,
    /// Routes, by their numbers, with the neighbours that the log already names for them.
    told: BTreeSet<(usize, [u8; 16])>,
    /// Publishers of other bridges on other topics, listened to: what they deliver must not come in by a relay.
    listened: BTreeMap<[u8; 16], AbortHandle>,
    /// How many use each route's topic in shared memory, when last looked at, by the numbers of the routes.
    in_memory: BTreeMap<usize, usize>,
    /// The publishers beside each route, by the numbers of the routes.
    met: BTreeMap<usize, NearbyPublishers>,
    lines: LogBudget,
    warnings: LogBudget,
}

impl Neighbourhood {
    pub(crate) fn new(local: LocalGraph, roster: Arc<Roster>) -> Self {
        let in_memory = roster.open().map(|open| (open.slot.number, count_in_memory(&open))).collect();
        let (known, told, listened, met) = (BTreeMap::new(), BTreeSet::new(), BTreeMap::new(), BTreeMap::new());
        let (lines, warnings) = (LogBudget::new(Instant::now()), LogBudget::new(Instant::now()));
        Self { local, roster, known, told, listened, in_memory, met, lines, warnings }
    }

    /// Takes note of a change, and tells what it means.
    pub(crate) fn note(&mut self, change: Change, now: Instant) {
        let (neighbour, came) = match change {
            Change::Came(neighbour) => (neighbour, true),
            Change::Left(neighbour) => (neighbour, false),
        };
        if came {
            self.known.insert(neighbour.guid, neighbour.clone());
            self.listen(&neighbour);
        } else {
            self.known.remove(&neighbour.guid);
            if let Some(listener) = self.listened.remove(&neighbour.guid) {
                listener.abort();
            }
        }
        let open: Vec<OpenRoute> = self.roster.open().collect();
        for open in open.iter().filter(|open| open.dds_topic() == neighbour.topic) {
            self.meet(open);
            self.look_beside(open, now);
            if came {
                self.tell_of(open, &neighbour, now);
            } else {
                self.tell(open, &neighbour, meaning(open, &neighbour, false), now);
            }
        }
        if !came {
            self.told.retain(|(_, guid)| *guid != neighbour.guid);
        }
    }

    /// Logs once what a known neighbour means for a route.
    fn tell_of(&mut self, open: &OpenRoute, neighbour: &Neighbour, now: Instant) {
        if self.told.insert((open.slot.number, neighbour.guid)) {
            let line = meaning(open, neighbour, true).map(|line| self.second(open, neighbour, line));
            self.tell(open, neighbour, line, now);
        }
    }

    /// Looks at what nobody tells: shared memory, and what those who came before a route mean for it; and says how much was not
    /// told.
    pub(crate) fn look(&mut self, now: Instant) {
        let is_new = |neighbour: &&Neighbour| neighbour.mark.is_some() && !self.listened.contains_key(&neighbour.guid);
        for neighbour in self.known.values().filter(is_new).cloned().collect::<Vec<_>>() {
            self.listen(&neighbour);
        }
        let open: Vec<OpenRoute> = self.roster.open().collect();
        self.told.retain(|(number, _)| open.iter().any(|open| open.slot.number == *number));
        for open in open {
            // A route that was opened late has neighbours of which nobody tells any more.
            self.meet(&open);
            self.look_beside(&open, now);
            let topic = open.dds_topic();
            let there = self.known.values().filter(|neighbour| neighbour.topic == topic).cloned();
            for neighbour in there.collect::<Vec<_>>() {
                self.tell_of(&open, &neighbour, now);
            }
            let count = count_in_memory(&open);
            let before = self.in_memory.entry(open.slot.number).or_insert(count);
            if count != *before
                && let Some(peers) = open.in_memory()
            {
                let (service, topic) = (&open.slot.route.service, open.topic().as_str());
                tracing::info!(
                    service,
                    topic,
                    "{count} {}s in shared memory now, {before} before",
                    peers.role().name()
                );
                *before = count;
            }
        }
        for lines in [&mut self.lines, &mut self.warnings] {
            if let Some(count) = lines.not_told(now) {
                tracing::info!(count, "{count} more publishers and subscribers have come or left");
            }
        }
    }

    /// The endpoints at the other end of a route.
    pub(crate) fn other_end(&self, open: &OpenRoute) -> OtherEnd {
        let mut other_end = OtherEnd::default();
        let (topic, wanted) = (open.dds_topic(), open.dds_type());
        for neighbour in self.known.values().filter(|neighbour| neighbour.topic == topic) {
            if neighbour.role == open.slot.route.kind.other_end {
                other_end.add(neighbour, &wanted, misfit(open, neighbour), is_bridge(neighbour, open.slot.mark));
            }
        }
        // A bridge is in shared memory as well; which one of them it is cannot be told.
        other_end.in_memory = count_in_memory(open).saturating_sub(other_end.bridges);
        other_end
    }

    /// Has a route follow the quality of service of those at its other end.
    fn meet(&self, open: &OpenRoute) {
        let (topic, wanted) = (open.dds_topic(), open.dds_type());
        let others = self.known.values().filter(|neighbour| {
            (neighbour.topic == topic && neighbour.type_name == wanted)
                && neighbour.role == open.slot.route.kind.other_end
                && !is_bridge(neighbour, open.slot.mark)
        });
        let others: Vec<&Neighbour> = others.collect();
        if let Some(met) = open.meet(&others) {
            let (service, topic) = (&open.slot.route.service, open.topic().as_str());
            tracing::info!(service, topic, "{met}: as the others on {topic}");
        }
    }

    /// Looks who publishes on the topic of a route that delivers commands there, other than an earlier run of this bridge.
    fn look_beside(&mut self, open: &OpenRoute, now: Instant) {
        if !open.is_command() || open.slot.route.kind.takes_in() {
            return;
        }
        let topic = open.dds_topic();
        let is_beside = |neighbour: &&Neighbour| neighbour.topic == topic && neighbour.role == Role::Publisher;
        let on_dds: Vec<&Neighbour> = self.known.values().filter(is_beside).collect();
        let in_memory = open.in_memory().map_or_else(Vec::new, Peers::publishers);
        let rogue = self.met.entry(open.slot.number).or_default().look(&on_dds, open.slot.mark, in_memory, now);
        open.slot.counters.lock().live.beside = rogue.count;
        let (service, topic) = (&open.slot.route.service, open.topic().as_str());
        if rogue.has_marked_news && self.warnings.spend(now) {
            tracing::warn!(
                service,
                topic,
                "a publisher beside this bridge on {topic} has its mark, and is no earlier run of it: that would have left; \
                 stop the other bridge of {service}, or who copies the mark"
            );
        }
        for process in rogue.news {
            if self.warnings.spend(now) {
                tracing::warn!(
                    service,
                    topic,
                    process,
                    "a publisher beside this bridge on {topic} in shared memory: its messages go around the ledger"
                );
            }
        }
    }

    /// A note becomes a warning where it is about a second publisher of commands: the bridge signs what both send.
    fn second(&self, open: &OpenRoute, neighbour: &Neighbour, line: Line) -> Line {
        let (topic, wanted) = (open.dds_topic(), open.dds_type());
        let is_source = |other: &&Neighbour| {
            (other.topic == topic && other.type_name == wanted && other.role == Role::Publisher)
                && !is_bridge(other, open.slot.mark)
        };
        let carries_messages = open.slot.route.kind.carries == Interface::Message;
        let sources = self.known.values().filter(is_source).count();
        match line {
            // Services have many callers.
            Line::Note(_) if open.is_command() && carries_messages && is_source(&neighbour) && sources > 1 => {
                let (topic, service) = (open.topic().as_str(), &open.slot.route.service);
                Line::Warning(format!(
                    "{sources} publishers on {topic} now: this bridge takes the commands of all of them to {service}"
                ))
            }
            line => line,
        }
    }

    /// Tells what somebody on a route's topic means. Warnings have a limit of their own: those who come and leave must
    /// not hide them.
    fn tell(&mut self, open: &OpenRoute, neighbour: &Neighbour, line: Option<Line>, now: Instant) {
        let (service, topic, role) = (&open.slot.route.service, open.topic().as_str(), neighbour.role.name());
        let (guid, found) = (hex::encode(neighbour.guid), quoted(&neighbour.type_name));
        match line {
            Some(Line::Note(text)) if self.lines.spend(now) => {
                let reliability = if neighbour.qos.is_reliable() { "reliable" } else { "best_effort" };
                tracing::info!(service, topic, role, guid, reliability, "{text}");
            }
            Some(Line::Warning(text)) if self.warnings.spend(now) => {
                let wanted = open.dds_type();
                tracing::warn!(service, topic, role, guid, found = %found, wanted, "{text}");
            }
            Some(_) | None => {}
        }
    }

    /// Hears what another bridge delivers of a service that a route of ours takes to the ledger from another topic.
    fn listen(&mut self, neighbour: &Neighbour) {
        let Some(mark) = neighbour.mark.filter(|_| neighbour.role == Role::Publisher) else { return };
        let meant = |open: &&OpenRoute| {
            open.slot.route.kind.takes_in() && open.slot.mark == mark && open.dds_type() == neighbour.type_name
        };
        let open: Vec<OpenRoute> = self.roster.open().collect();
        let Some(open) = open.iter().find(meant) else { return };
        self.local.delivered().begins(mark);
        if open.dds_topic() == neighbour.topic || self.listened.len() >= LISTENED_MAX {
            return; // The route itself hears it.
        }
        let topic = neighbour.topic.strip_prefix("rt").and_then(|topic| TopicName::parse(topic).ok());
        let Some(topic) = topic else { return };
        // What is lost here would pass as a relay's own.
        let is_reliable = neighbour.qos.is_reliable();
        let reliability = if is_reliable { Reliability::Reliable } else { Reliability::BestEffort };
        let qos = Qos { reliability, ..Qos::default() };
        let limits = Limits { sample_bytes_max: open.slot.route.sample_bytes_max, ..Limits::default() };
        match self.local.participant().reader(&topic, &open.slot.route.message, &qos, limits) {
            Ok(mut reader) => {
                let delivered = Arc::clone(self.local.delivered());
                let listener = tokio::spawn(async move {
                    while let Some(incoming) = reader.next().await {
                        delivered.note(mark, incoming.sample.wire(), incoming.received);
                    }
                });
                self.listened.insert(neighbour.guid, listener.abort_handle());
                let service = &open.slot.route.service;
                tracing::info!(
                    service,
                    topic = topic.as_str(),
                    "another bridge delivers {service} on {topic}: samples from there are not taken in"
                );
            }
            Err(error) if self.warnings.spend(Instant::now()) => {
                tracing::warn!(%topic, %error, "cannot receive messages that another bridge delivers here");
            }
            Err(_) => {}
        }
    }
}

impl Drop for Neighbourhood {
    fn drop(&mut self) {
        self.listened.values().for_each(AbortHandle::abort);
    }
}

fn count_in_memory(open: &OpenRoute) -> usize {
    open.in_memory().map_or(0, Peers::count)
}
