//! Finds the participants of a domain (SPDP, §8.5.3) and their endpoints (SEDP, §8.5.4), and announces the own ones.
//!
//! A participant is kept as long as anything comes from it: each datagram renews its lease, as in Fast DDS and CycloneDDS. When it is
//! over, or the participant says that it leaves, its endpoints are gone with it. It is found again by its next announcement, with
//! nothing kept from before. An announcement counts for the participant that sends it, and for its own endpoints only.
//!
//! Memory: a participant takes 48 KiB with its builtin endpoints, an endpoint 8 KiB. Announcements that wait for missing ones take 128 KiB
//! of a participant and 16 MiB of all, for each of three kinds.
//! Their numbers are limited by [`PARTICIPANTS_MAX`], [`ENDPOINTS_OF_PARTICIPANT_MAX`] and [`ENDPOINTS_MAX`]; more are
//! ignored until others go.

mod announcer;
mod builtin_endpoints;
mod liveliness;
pub(crate) mod locators;
mod remote;
mod writer_leases;

use crate::announcement::{EndpointData, ParticipantData, key_of};
use crate::endpoint::{Delivered, DisposedKey, Outgoing, Peer};
use crate::guid::{EntityId, Guid, GuidPrefix};
use crate::interface::{Channel, Config, Counters, RemoteEndpoint, UnreachableParticipant};
use crate::limits::{ENDPOINTS_MAX, ENDPOINTS_OF_PARTICIPANT_MAX, PARTICIPANTS_MAX};
use crate::time::Now;
use crate::timers::Timers;
use crate::wire::submessage::{Addressed, Data, Payload, Submessage};
use announcer::Announcer;
use builtin_endpoints::BuiltinEndpoints;
use remote::RemoteParticipant;
use std::collections::BTreeMap;
use std::net::SocketAddrV4;
pub(crate) use writer_leases::LivelinessChange;
use writer_leases::WriterLeases;

/// A change of an endpoint of another participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// It is new, or its announcement has changed.
    Found(Box<RemoteEndpoint>),
    /// It is reached by other addresses.
    Moved(Guid),
    /// It is not there any more.
    Gone(Guid),
    /// A participant cannot be reached.
    Unreachable(UnreachableParticipant),
    /// It can be reached now, or has gone.
    NotUnreachable(Guid),
    /// The liveliness of a writer has ended or begun again.
    Liveliness(LivelinessChange),
    /// The numbers of a builtin writer began again, or its messages were forged.
    Resynchronized(Guid),
}

/// The other participants, their endpoints, and the builtin endpoints of this one.
#[derive(Debug)]
pub(crate) struct Discovery {
    config: Config,
    announcer: Announcer,
    builtin: BuiltinEndpoints,
    participants: BTreeMap<GuidPrefix, RemoteParticipant>,
    /// Of all participants.
    endpoint_count: usize,
    /// When participants are given up. Invariant: the same keys as `participants`.
    leases: Timers<GuidPrefix>,
    writer_leases: WriterLeases,
    /// Answers to participants that are new.
    replies: Vec<Outgoing>,
    counters: Counters,
}

impl Discovery {
    pub(crate) fn new(config: Config, now: Now) -> Self {
        Self {
            announcer: Announcer::new(&config, now),
            builtin: BuiltinEndpoints::new(config.prefix),
            participants: BTreeMap::new(),
            endpoint_count: 0,
            leases: Timers::default(),
            writer_leases: WriterLeases::default(),
            replies: Vec::new(),
            counters: Counters::default(),
            config,
        }
    }

    pub(crate) fn config(&self) -> &Config {
        &self.config
    }

    /// An endpoint of others, and how it is reached.
    pub(crate) fn endpoint(&self, guid: Guid) -> Option<(&RemoteEndpoint, Option<Peer>)> {
        let participant = self.participants.get(&guid.prefix)?;
        let entry = participant.endpoints.get(&guid.entity)?;
        Some((&entry.endpoint, participant.endpoint_peer(entry)))
    }

    /// The participants that cannot be reached.
    pub(crate) fn unreachable(&self) -> impl Iterator<Item = UnreachableParticipant> {
        self.participants.values().filter_map(RemoteParticipant::unreachable)
    }

    /// All endpoints of others.
    pub(crate) fn endpoints(&self) -> impl Iterator<Item = &RemoteEndpoint> {
        self.participants.values().flat_map(|participant| participant.endpoints.values()).map(|entry| &entry.endpoint)
    }

    /// Counts of rejected and ignored announcements; those of datagrams and samples are zero here.
    pub(crate) fn counters(&self) -> Counters {
        self.counters
    }

    /// Bytes of announcements that wait for others or for fragments.
    pub(crate) fn held(&self) -> usize {
        self.builtin.held()
    }

    /// This process stood still for a time in which others could not be heard: it does not count for their leases.
    pub(crate) fn stood_still(&mut self, time: u64) {
        self.leases.postpone(time);
        self.writer_leases.postpone(time);
    }

    /// Something has come from a participant. Returns whether it is known.
    pub(crate) fn renew(&mut self, now: Now, prefix: GuidPrefix, events: &mut Vec<Event>) -> bool {
        let Some(participant) = self.participants.get(&prefix) else { return false };
        self.leases.set(prefix, Some(now.steady.saturating_add(participant.lease())));
        let mut changes = Vec::new();
        self.writer_leases.heard(now, prefix, &mut changes);
        events.extend(changes.into_iter().map(Event::Liveliness));
        true
    }

    /// A writer of others has written, or asserts its liveliness.
    pub(crate) fn wrote(&mut self, now: Now, writer: Guid, events: &mut Vec<Event>) {
        let mut changes = Vec::new();
        self.writer_leases.wrote(now, writer, &mut changes);
        events.extend(changes.into_iter().map(Event::Liveliness));
    }

    /// Is a writer of others alive, as far as its lease says?
    pub(crate) fn is_alive(&self, writer: Guid) -> bool {
        self.writer_leases.is_alive(writer)
    }

    /// An own writer of kind MANUAL_BY_PARTICIPANT has written, or is asserted.
    pub(crate) fn assert_manually(&mut self, now: Now) {
        self.builtin.assert_manually(now);
    }

    /// A submessage from or to a builtin endpoint.
    pub(crate) fn receive(
        &mut self,
        now: Now,
        from: SocketAddrV4,
        channel: Channel,
        message: &Addressed,
        events: &mut Vec<Event>,
    ) {
        match &message.submessage {
            Submessage::Data(data) if data.writer == EntityId::SPDP_WRITER => {
                self.receive_participant(now, from, channel, message.source, data, events);
            }
            _ if self.participants.contains_key(&message.source) => {
                let mut delivered = Vec::new();
                self.builtin.receive(now, message, &mut delivered);
                self.receive_announcements(now, delivered, events);
            }
            _ => {}
        }
    }

    fn receive_participant(
        &mut self,
        now: Now,
        from: SocketAddrV4,
        channel: Channel,
        source: GuidPrefix,
        data: &Data,
        events: &mut Vec<Event>,
    ) {
        let is_end = data.inline_qos.status != 0;
        match &data.payload {
            Payload::Data(payload) if !is_end => match ParticipantData::from_payload(payload) {
                Ok(announced) if announced.prefix == source => {
                    self.participant_announced(now, from, channel, announced, events);
                }
                Ok(_) => {
                    self.counters.announcements_rejected += 1;
                    tracing::debug!(%source, "a participant was announced by another one");
                }
                Err(error) => {
                    self.counters.announcements_rejected += 1;
                    tracing::debug!(%source, %error, "a participant was announced in a way that is not understood")
                }
            },
            Payload::Data(payload) | Payload::Key(payload) => {
                let hash = data.inline_qos.key_hash.map(Guid::from_bytes);
                if key_of(payload).or(hash).is_some_and(|guid| guid.prefix == source) {
                    self.remove_participant(now, source, events);
                }
            }
            Payload::None => {
                let hash = data.inline_qos.key_hash.map(Guid::from_bytes);
                if is_end && hash.is_some_and(|guid| guid.prefix == source) {
                    self.remove_participant(now, source, events);
                }
            }
        }
    }

    fn participant_announced(
        &mut self,
        now: Now,
        from: SocketAddrV4,
        channel: Channel,
        data: ParticipantData,
        events: &mut Vec<Event>,
    ) {
        if data.domain.is_some_and(|domain| domain != u32::from(self.config.domain)) {
            return;
        }
        let prefix = data.prefix;
        let before = self.participants.get(&prefix).and_then(RemoteParticipant::unreachable);
        if let Some(participant) = self.participants.get_mut(&prefix) {
            if let Some(moved) = participant.update(&self.config, now, data, from, channel) {
                events.extend(moved.into_iter().map(|entity| Event::Moved(Guid::new(prefix, entity))));
                self.connect(now, prefix);
            }
        } else if self.participants.len() < PARTICIPANTS_MAX {
            let participant = RemoteParticipant::new(&self.config, now, data, from, channel);
            self.announcer.reply(now, prefix, participant.discovery_addresses(), &mut self.replies);
            self.participants.insert(prefix, participant);
            self.connect(now, prefix);
        } else {
            self.counters.beyond_limits += 1;
        }
        let after = self.participants.get(&prefix).and_then(RemoteParticipant::unreachable);
        match (before, after) {
            (None, Some(unreachable)) => events.push(Event::Unreachable(unreachable)),
            (Some(before), None) => events.push(Event::NotUnreachable(before.guid)),
            _ => {}
        }
        self.renew(now, prefix, events);
    }

    /// Matches the builtin endpoints of a participant with the own ones, or gives them its new addresses.
    fn connect(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(participant) = self.participants.get(&prefix) else { return };
        if let Some(peer) = participant.builtin_peer() {
            self.builtin.add_participant(now, &peer, participant.builtin_endpoints());
        }
    }

    /// A participant leaves.
    fn remove_participant(&mut self, now: Now, prefix: GuidPrefix, events: &mut Vec<Event>) {
        if self.take_participant(prefix, events).is_some() {
            self.builtin.remove_participant(now, prefix);
        }
    }

    fn take_participant(&mut self, prefix: GuidPrefix, events: &mut Vec<Event>) -> Option<RemoteParticipant> {
        let participant = self.participants.remove(&prefix)?;
        self.leases.set(prefix, None);
        self.endpoint_count = self.endpoint_count.saturating_sub(participant.endpoints.len());
        events.extend(participant.unreachable().map(|participant| Event::NotUnreachable(participant.guid)));
        for entity in participant.endpoints.keys() {
            self.writer_leases.remove(Guid::new(prefix, *entity));
            events.push(Event::Gone(Guid::new(prefix, *entity)));
        }
        Some(participant)
    }

    fn receive_announcements(&mut self, now: Now, delivered: Vec<Delivered>, events: &mut Vec<Event>) {
        for delivered in delivered {
            match delivered {
                Delivered::Sample(sample) if sample.writer.entity == EntityId::LIVELINESS_WRITER => {
                    let prefix = sample.writer.prefix;
                    if liveliness::is_manual(prefix, &sample.payload) {
                        let mut changes = Vec::new();
                        self.writer_leases.asserted(now, prefix, &mut changes);
                        events.extend(changes.into_iter().map(Event::Liveliness));
                    }
                }
                Delivered::Sample(sample) => match EndpointData::from_payload(&sample.payload) {
                    Ok(data) if is_announced_by(data.guid, sample.writer) => self.endpoint_announced(now, data, events),
                    Ok(data) => {
                        self.counters.announcements_rejected += 1;
                        tracing::debug!(guid = %data.guid, by = %sample.writer, "an endpoint was announced by another");
                    }
                    Err(error) => {
                        self.counters.announcements_rejected += 1;
                        tracing::debug!(by = %sample.writer, %error, "an announcement is not understood");
                    }
                },
                Delivered::Disposed { writer, key } => {
                    let guid = match key {
                        DisposedKey::Hash(hash) => Some(Guid::from_bytes(hash)),
                        DisposedKey::Serialized(key) => key_of(&key),
                        DisposedKey::Unknown => None,
                    };
                    if let Some(guid) = guid.filter(|guid| is_announced_by(*guid, writer)) {
                        self.endpoint_gone(guid, events);
                    }
                }
                Delivered::Lost { .. } | Delivered::DeadlineMissed { .. } => {}
                // Its numbers began again: it is another one under the same name. All of it is found again.
                Delivered::Resynchronized { writer } => {
                    events.push(Event::Resynchronized(writer));
                    self.remove_participant(now, writer.prefix, events);
                }
            }
        }
    }

    fn endpoint_announced(&mut self, now: Now, data: EndpointData, events: &mut Vec<Event>) {
        let guid = data.guid;
        let Some(participant) = self.participants.get_mut(&guid.prefix) else { return };
        let Some(entry) = participant.entry(&self.config, data) else {
            self.counters.beyond_limits += 1;
            return;
        };
        let known = participant.endpoints.get(&guid.entity);
        if known == Some(&entry) {
            return;
        }
        if known.is_none() {
            if participant.endpoints.len() >= ENDPOINTS_OF_PARTICIPANT_MAX || self.endpoint_count >= ENDPOINTS_MAX {
                self.counters.beyond_limits += 1;
                return;
            }
            self.endpoint_count += 1;
        }
        let was_alive = self.writer_leases.is_alive(guid);
        if guid.entity.is_writer() {
            self.writer_leases.add(now, guid, &entry.endpoint.qos);
        }
        events.push(Event::Found(Box::new(entry.endpoint.clone())));
        if !was_alive {
            events.push(Event::Liveliness(LivelinessChange { writer: guid, is_alive: true }));
        }
        participant.endpoints.insert(guid.entity, entry);
    }

    fn endpoint_gone(&mut self, guid: Guid, events: &mut Vec<Event>) {
        let Some(participant) = self.participants.get_mut(&guid.prefix) else { return };
        if participant.endpoints.remove(&guid.entity).is_some() {
            self.endpoint_count = self.endpoint_count.saturating_sub(1);
            self.writer_leases.remove(guid);
            events.push(Event::Gone(guid));
        }
    }

    /// Announces an own endpoint, or what has changed of it.
    pub(crate) fn announce(&mut self, now: Now, data: &EndpointData) {
        self.builtin.announce(now, data);
    }

    /// An own endpoint has been closed.
    pub(crate) fn withdraw(&mut self, now: Now, entity: EntityId) {
        self.builtin.withdraw(now, entity);
    }

    /// Puts out what is due, and gives up the participants whose leases are over.
    pub(crate) fn poll(&mut self, now: Now, out: &mut Vec<Outgoing>, events: &mut Vec<Event>) {
        for prefix in self.leases.take_due(now.steady) {
            let Some(participant) = self.take_participant(prefix, events) else { continue };
            self.builtin.lose_participant(now, prefix, now.steady.saturating_sub(participant.lease()));
        }
        let mut changes = Vec::new();
        self.writer_leases.poll(now, &mut changes);
        events.extend(changes.into_iter().map(Event::Liveliness));
        out.append(&mut self.replies);
        let unicast = self.participants.values().filter(|participant| !participant.is_heard_by_multicast);
        self.announcer.poll(now, unicast.flat_map(RemoteParticipant::discovery_addresses).copied(), out);
        self.builtin.poll(now, out);
    }

    /// Announces to all participants that this one leaves, with all its endpoints.
    pub(crate) fn leave(&mut self, now: Now, out: &mut Vec<Outgoing>) {
        let own: Vec<EntityId> = self.builtin.announced().collect();
        for entity in own {
            self.builtin.withdraw(now, entity);
        }
        self.builtin.poll(now, out);
        let others = self.participants.values().flat_map(RemoteParticipant::discovery_addresses).copied();
        self.announcer.leave(now, others, out);
    }

    /// When [`Discovery::poll`] has something to do next.
    pub(crate) fn deadline(&self) -> Option<u64> {
        let leases = [self.leases.next(), self.writer_leases.deadline()];
        let timers = leases.into_iter().chain([self.builtin.deadline(), Some(self.announcer.deadline())]);
        timers.flatten().min()
    }
}

/// Does this builtin writer announce endpoints of that kind, and of its own participant?
fn is_announced_by(guid: Guid, writer: Guid) -> bool {
    let is_kind = match writer.entity {
        EntityId::PUBLICATIONS_WRITER => matches!(guid.entity.kind(), 0x02 | 0x03),
        EntityId::SUBSCRIPTIONS_WRITER => matches!(guid.entity.kind(), 0x04 | 0x07),
        _ => false,
    };
    is_kind && guid.prefix == writer.prefix
}
