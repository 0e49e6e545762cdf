//! The neighbours on the topics of a bridge, and their meaning for its routes.

mod strangers;

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use rustdds::QosPolicies;
use tokio::task::AbortHandle;

use self::strangers::Met;
use crate::{
    dds::{Change, Neighbour, Role, encoding::accepted},
    mark::Mark,
    names::{Interface, TopicName, quoted},
    qos::{Qos, Reliability},
    queue::Limits,
    roster::{Roster, Watched},
    route::{kind::Beside, local::Local, silence::Surroundings},
};

/// At most so many lines about those who come and leave ...
const LINES_MAX: u32 = 20;
/// ... in this time.
const LINES_IN: Duration = Duration::from_secs(10);
/// Most publishers of other bridges that are listened to.
const LISTENED_MAX: usize = 16;

/// The known neighbours.
pub(super) struct Neighbourhood {
    local: Local,
    roster: Arc<Roster>,
    known: BTreeMap<[u8; 16], Neighbour>,
    /// Publishers of other bridges on other topics, listened to: what they deliver must not come in by a relay.
    listened: BTreeMap<[u8; 16], AbortHandle>,
    /// How many use each route's topic in shared memory, when last looked at, by the numbers of the routes.
    in_memory: BTreeMap<usize, usize>,
    /// The publishers beside each route, by the numbers of the routes.
    met: BTreeMap<usize, Met>,
    lines: Lines,
    warnings: Lines,
}

/// Limits lines in their rate.
#[derive(Debug)]
struct Lines {
    since: Instant,
    count: u32,
    not_told: u64,
}

impl Neighbourhood {
    pub(super) fn new(local: Local, roster: Arc<Roster>) -> Self {
        let in_memory = roster.open().map(|watched| (watched.number, count_in_memory(&watched))).collect();
        let (known, listened, met) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let lines = || Lines { since: Instant::now(), count: 0, not_told: 0 };
        Self { local, roster, known, listened, in_memory, met, lines: lines(), warnings: lines() }
    }

    /// Takes note of a change, and tells what it means.
    pub(super) fn note(&mut self, change: Change, now: Instant) {
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
        let open: Vec<Arc<Watched>> = self.roster.open().collect();
        for watched in open.iter().filter(|watched| watched.dds_topic() == neighbour.topic) {
            self.meet(watched);
            self.look_beside(watched, now);
            let line = meaning(watched, &neighbour, came);
            let line = if came { line.map(|line| self.second(watched, &neighbour, line)) } else { line };
            self.tell(watched, &neighbour, line, now);
        }
    }

    /// Looks at what nobody tells: shared memory, and what those who came before a route mean for it; and says how much was not
    /// told.
    pub(super) fn look(&mut self, now: Instant) {
        let is_new = |neighbour: &&Neighbour| neighbour.mark.is_some() && !self.listened.contains_key(&neighbour.guid);
        for neighbour in self.known.values().filter(is_new).cloned().collect::<Vec<_>>() {
            self.listen(&neighbour);
        }
        let open: Vec<Arc<Watched>> = self.roster.open().collect();
        for watched in open {
            // A route that was opened late has neighbours of which nobody tells any more.
            self.meet(&watched);
            self.look_beside(&watched, now);
            let count = count_in_memory(&watched);
            let before = self.in_memory.entry(watched.number).or_insert(count);
            if count != *before
                && let Some(peers) = &watched.in_memory
            {
                let (service, topic) = (&watched.route.service, watched.topic.as_str());
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
    pub(super) fn surroundings(&self, watched: &Watched) -> Surroundings {
        let mut surroundings = Surroundings::default();
        let (topic, wanted) = (watched.dds_topic(), watched.dds_type());
        for neighbour in self.known.values().filter(|neighbour| neighbour.topic == topic) {
            if neighbour.role == watched.route.kind.other_end {
                surroundings.add(neighbour, &wanted, misfit(watched, neighbour), is_bridge(neighbour, watched.mark));
            }
        }
        // A bridge is in shared memory as well; which one of them it is cannot be told.
        surroundings.in_memory = count_in_memory(watched).saturating_sub(surroundings.bridges);
        surroundings
    }

    /// Has a route follow the quality of service of those at its other end.
    fn meet(&self, watched: &Watched) {
        let (topic, wanted) = (watched.dds_topic(), watched.dds_type());
        let others = self.known.values().filter(|neighbour| {
            (neighbour.topic == topic && neighbour.type_name == wanted)
                && neighbour.role == watched.route.kind.other_end
                && !is_bridge(neighbour, watched.mark)
        });
        let others: Vec<&Neighbour> = others.collect();
        if let Some(met) = watched.meet(&others) {
            let (service, topic) = (&watched.route.service, watched.topic.as_str());
            let (reliability, durability) = (met.reliability.name(), met.durability.name());
            let keys = if met.keyed { ", with keys" } else { "" };
            tracing::info!(service, topic, "{reliability}, {durability}{keys}: as the others on {topic}");
        }
    }

    /// Looks who publishes on the topic of a route that delivers commands there, other than an earlier run of this bridge.
    fn look_beside(&mut self, watched: &Watched, now: Instant) {
        if !watched.is_command || watched.route.kind.takes_in() {
            return;
        }
        let topic = watched.dds_topic();
        let is_beside = |neighbour: &&Neighbour| neighbour.topic == topic && neighbour.role == Role::Publisher;
        let on_dds: Vec<&Neighbour> = self.known.values().filter(is_beside).collect();
        let in_memory = watched.in_memory.as_ref().map_or_else(Vec::new, crate::shm::Peers::publishers);
        let strangers = self.met.entry(watched.number).or_default().look(&on_dds, watched.mark, in_memory, now);
        watched.counters.lock().live.beside = strangers.count;
        let (service, topic) = (&watched.route.service, watched.topic.as_str());
        if strangers.has_marked_news && self.warnings.may_tell(now) {
            tracing::warn!(
                service,
                topic,
                "a publisher beside this bridge on {topic} has its mark, and is no earlier run of it: that would have left; \
                 stop the other bridge of {service}, or who copies the mark"
            );
        }
        for process in strangers.news {
            if self.warnings.may_tell(now) {
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
    fn second(&self, watched: &Watched, neighbour: &Neighbour, line: Line) -> Line {
        let (topic, wanted) = (watched.dds_topic(), watched.dds_type());
        let is_source = |other: &&Neighbour| {
            (other.topic == topic && other.type_name == wanted && other.role == Role::Publisher)
                && !is_bridge(other, watched.mark)
        };
        let carries_messages = watched.route.kind.carries == Interface::Message;
        let sources = self.known.values().filter(is_source).count();
        match line {
            // Services have many callers.
            Line::Note(_) if watched.is_command && carries_messages && is_source(&neighbour) && sources > 1 => {
                let (topic, service) = (watched.topic.as_str(), &watched.route.service);
                Line::Warning(format!(
                    "{sources} publishers on {topic} now: this bridge takes the commands of all of them to {service}"
                ))
            }
            line => line,
        }
    }

    /// Tells what somebody on a route's topic means. Warnings have a limit of their own: those who come and leave must
    /// not hide them.
    fn tell(&mut self, watched: &Watched, neighbour: &Neighbour, line: Option<Line>, now: Instant) {
        let (service, topic, role) = (&watched.route.service, watched.topic.as_str(), neighbour.role.name());
        let (guid, found) = (hex::encode(neighbour.guid), quoted(&neighbour.type_name));
        match line {
            Some(Line::Note(text)) if self.lines.may_tell(now) => {
                let reliability = if neighbour.qos.is_reliable() { "reliable" } else { "best_effort" };
                tracing::info!(service, topic, role, guid, reliability, "{text}");
            }
            Some(Line::Warning(text)) if self.warnings.may_tell(now) => {
                let wanted = watched.dds_type();
                tracing::warn!(service, topic, role, guid, found = %found, wanted, "{text}");
            }
            Some(_) | None => {}
        }
    }

    /// Hears what another bridge delivers of a service that a route of ours takes to the ledger from another topic.
    fn listen(&mut self, neighbour: &Neighbour) {
        let Some(mark) = neighbour.mark.filter(|_| neighbour.role == Role::Publisher) else { return };
        let meant = |watched: &&Arc<Watched>| {
            watched.route.kind.takes_in() && watched.mark == mark && watched.dds_type() == neighbour.type_name
        };
        let open: Vec<Arc<Watched>> = self.roster.open().collect();
        let Some(watched) = open.iter().find(meant) else { return };
        self.local.delivered().begins(mark);
        if watched.dds_topic() == neighbour.topic || self.listened.len() >= LISTENED_MAX {
            return; // The route itself hears it.
        }
        let topic = neighbour.topic.strip_prefix("rt").and_then(|topic| TopicName::parse(topic).ok());
        let Some(topic) = topic else { return };
        // What is lost here would pass as a relay's own.
        let is_reliable = neighbour.qos.is_reliable();
        let reliability = if is_reliable { Reliability::Reliable } else { Reliability::BestEffort };
        let qos = Qos { reliability, ..Qos::default() };
        let limits = Limits { sample_bytes_max: watched.route.sample_bytes_max, ..Limits::default() };
        match self.local.participant().reader(&topic, &watched.route.message, &qos, limits) {
            Ok(mut reader) => {
                let delivered = Arc::clone(self.local.delivered());
                let listener = tokio::spawn(async move {
                    while let Some(incoming) = reader.next().await {
                        delivered.note(mark, incoming.sample.wire(), incoming.received);
                    }
                });
                self.listened.insert(neighbour.guid, listener.abort_handle());
                let service = &watched.route.service;
                tracing::info!(
                    service,
                    topic = topic.as_str(),
                    "another bridge delivers {service} on {topic}: samples from there are not taken in"
                );
            }
            Err(error) if self.warnings.may_tell(Instant::now()) => {
                tracing::warn!(%topic, %error, "cannot hear what another bridge delivers here");
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

fn count_in_memory(watched: &Watched) -> usize {
    watched.in_memory.as_ref().map_or(0, crate::shm::Peers::count)
}

fn is_bridge(neighbour: &Neighbour, own: Mark) -> bool {
    neighbour.mark.is_some_and(|mark| mark.is_of_network_of(own))
}

/// The reason for which DDS keeps both apart: a policy, or that one of them alone has keys.
fn misfit(watched: &Watched, neighbour: &Neighbour) -> Option<String> {
    let qos = *watched.qos.borrow();
    if qos.keyed != neighbour.is_keyed() {
        return Some("keys".to_owned());
    }
    let ours: QosPolicies = qos.policies();
    let accepts = ours.clone().with_data_representation(accepted());
    let (offered, requested) = match neighbour.role {
        Role::Publisher => (&neighbour.qos, &accepts),
        Role::Subscriber => (&ours, &neighbour.qos),
    };
    offered.compliance_failure_wrt(requested).map(|policy| format!("{policy:?}").to_lowercase())
}

/// The line to write.
enum Line {
    Note(String),
    Warning(String),
}

impl Lines {
    fn may_tell(&mut self, now: Instant) -> bool {
        if now.saturating_duration_since(self.since) > LINES_IN {
            (self.since, self.count) = (now, 0);
        }
        self.count = self.count.saturating_add(1);
        let may = self.count <= LINES_MAX;
        self.not_told = self.not_told.saturating_add(u64::from(!may));
        may
    }

    /// How many lines were left out, once there is room again.
    fn not_told(&mut self, now: Instant) -> Option<u64> {
        let has_room = now.saturating_duration_since(self.since) > LINES_IN;
        (has_room && self.not_told > 0).then(|| std::mem::take(&mut self.not_told))
    }
}

/// The meaning of an arrival or a departure on its topic for a route.
fn meaning(watched: &Watched, neighbour: &Neighbour, came: bool) -> Option<Line> {
    let (service, topic, role) = (&watched.route.service, watched.topic.as_str(), neighbour.role.name());
    let is_same_service = neighbour.mark == Some(watched.mark);
    let kind = watched.route.kind;
    if neighbour.role != kind.other_end {
        let beside = Beside { service, topic, is_same_service, is_command: watched.is_command };
        return (kind.beside)(&beside).filter(|_| came).map(Line::Warning);
    }
    if !came {
        return Some(Line::Note(format!("a {role} on {topic} has left")));
    }
    Some(if neighbour.type_name != watched.dds_type() {
        Line::Warning(format!(
            "a {role} on {topic} has another type: nothing passes until it has the `type` of this route"
        ))
    } else if neighbour.role == Role::Publisher && is_bridge(neighbour, watched.mark) {
        Line::Warning(format!(
            "another bridge publishes on {topic} what came from the ledger, and this route takes {topic} to {service}: \
             this would be a circle, so what the bridge publishes is not taken in; give one of both another topic or domain"
        ))
    } else if is_same_service {
        Line::Warning(format!(
            "another bridge takes {topic} to {service}, and this route delivers {service} on {topic}: this would be a \
             circle, so it does not take that in; give one of both another topic or domain"
        ))
    } else if let Some(policy) = misfit(watched, neighbour) {
        Line::Warning(format!("the qos of a {role} on {topic} does not fit ({policy}): nothing passes"))
    } else {
        Line::Note(format!("a {role} on {topic} has come"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_limited_and_those_left_out_are_counted() {
        let start = Instant::now();
        let mut lines = Lines { since: start, count: 0, not_told: 0 };
        let told = (0..100).filter(|number| lines.may_tell(start + Duration::from_millis(*number))).count();
        assert_eq!(told, LINES_MAX as usize);
        assert_eq!(lines.not_told(start + Duration::from_secs(1)), None);
        let later = start + LINES_IN + Duration::from_secs(1);
        assert_eq!(lines.not_told(later), Some(80));
        assert_eq!(lines.not_told(later), None);
        assert!(lines.may_tell(later));
    }
}
