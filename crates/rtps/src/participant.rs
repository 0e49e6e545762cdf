//! A participant of a DDS domain: time, datagrams and commands go in, datagrams, samples and matches come out.
//!
//! ```text
//! participant   step: own endpoints, leaving, time that was missed
//! routing       which reader or writer a submessage is for
//! matching      which own endpoints match which of others
//! packing       submessages into datagrams
//! ```

mod matching;
mod packing;
mod routing;
#[cfg(test)]
mod tests;

use crate::announcement::EndpointData;
use crate::discovery::{Discovery, Event};
use crate::endpoint::{Delivered, Outgoing};
use crate::guid::{EntityId, Guid};
use crate::interface::{
    Config, Counters, EndpointSettings, Input, OutgoingSample, Output, RemoteEndpoint, UnreachableParticipant,
    WriterLosses,
};
use crate::limits::PARTICIPANT_BYTES_MAX;
use crate::qos::LivelinessKind;
use crate::reader::{self, Reader};
use crate::time::Now;
use crate::timers::Timers;
use crate::writer::Writer;
use matching::Fit;
use std::collections::BTreeMap;

/// A step that is later than its deadline by this much, microseconds, shows that the process stood still (SIGSTOP, a suspended host).
const LATE_MIN: u64 = 100_000;
/// Keys of endpoints have 24 bits.
const KEYS: u32 = 1 << 24;

/// An own endpoint.
#[derive(Debug)]
struct OwnEndpoint {
    settings: EndpointSettings,
    role: Role,
}

#[derive(Debug)]
enum Role {
    Writer {
        writer: Box<Writer>,
        /// Was anything not acknowledged since [`Output::Acknowledged`] was said last?
        is_awaited: bool,
    },
    Reader(Box<Reader>),
}

/// A participant.
#[derive(Debug)]
pub struct Participant {
    guid: Guid,
    discovery: Discovery,
    own: BTreeMap<EntityId, OwnEndpoint>,
    /// The key of the endpoint that was opened last.
    key: u32,
    /// Endpoints of others with the own ones of the same topic and type. Invariant: an own reader or writer knows those that are
    /// [`Fit::Matched`] here, and no others.
    matches: BTreeMap<Guid, BTreeMap<EntityId, Fit>>,
    /// Invariant: each own endpoint that has something to do is due.
    timers: Timers<EntityId>,
    /// Bytes of samples that wait in own readers. Invariant: the sum of what they hold.
    held: usize,
    counters: Counters,
    /// The steady clock at the last step.
    last: u64,
    /// When the next step was due after the last one.
    due: Option<u64>,
    has_left: bool,
}

impl Participant {
    /// Announces itself by its first step, which is due at once.
    pub fn new(config: Config, now: Now) -> Self {
        let guid = Guid::new(config.prefix, EntityId::PARTICIPANT);
        let discovery = Discovery::new(config, now);
        Self {
            guid,
            due: discovery.deadline(),
            discovery,
            own: BTreeMap::new(),
            key: 0,
            matches: BTreeMap::new(),
            timers: Timers::default(),
            held: 0,
            counters: Counters::default(),
            last: now.steady,
            has_left: false,
        }
    }

    /// Identifies the participant.
    pub fn guid(&self) -> Guid {
        self.guid
    }

    /// The writers of other participants.
    pub fn publishers(&self) -> impl Iterator<Item = &RemoteEndpoint> {
        self.discovery.endpoints().filter(|endpoint| endpoint.guid.entity.is_writer())
    }

    /// The readers of other participants.
    pub fn subscribers(&self) -> impl Iterator<Item = &RemoteEndpoint> {
        self.discovery.endpoints().filter(|endpoint| endpoint.guid.entity.is_reader())
    }

    /// The other participants that announce no address by which they can be reached: their endpoints are not found.
    pub fn unreachable(&self) -> impl Iterator<Item = UnreachableParticipant> {
        self.discovery.unreachable()
    }

    /// Have all reliable readers everything that this own writer has written? True if it is not open.
    pub fn is_acknowledged(&self, writer: EntityId) -> bool {
        self.writer(writer).is_none_or(Writer::is_acknowledged)
    }

    /// Bytes of samples that this own writer keeps and not all reliable readers have.
    pub fn unacknowledged_bytes(&self, writer: EntityId) -> usize {
        self.writer(writer).map_or(0, Writer::unacknowledged_bytes)
    }

    /// Samples that this own writer has dropped before all reliable readers had them. None if it is not open.
    pub fn writer_losses(&self, writer: EntityId) -> Option<WriterLosses> {
        self.writer(writer).map(Writer::losses)
    }

    /// Counts of what was rejected and ignored so far.
    pub fn counters(&self) -> Counters {
        let Counters { announcements_rejected, beyond_limits, .. } = self.discovery.counters();
        Counters { announcements_rejected, beyond_limits, ..self.counters }
    }

    /// Bytes of samples and announcements that wait for others or for fragments: at most [`PARTICIPANT_BYTES_MAX`], and three times
    /// [`ANNOUNCEMENTS_BYTES_MAX`](crate::limits::ANNOUNCEMENTS_BYTES_MAX).
    pub fn held_bytes(&self) -> usize {
        self.held.saturating_add(self.discovery.held())
    }

    fn writer(&self, entity: EntityId) -> Option<&Writer> {
        match &self.own.get(&entity)?.role {
            Role::Writer { writer, .. } => Some(writer),
            Role::Reader(_) => None,
        }
    }

    /// When the next step is due, by the steady clock, if no input comes before.
    pub fn deadline(&self) -> Option<u64> {
        self.due
    }

    /// Takes an input in, and does all that is due.
    pub fn step(&mut self, now: Now, input: Input, out: &mut Vec<Output>) {
        // The steady clock never goes back; if it does, it stands still here.
        let now = Now { steady: now.steady.max(self.last), ..now };
        if self.has_left {
            return;
        }
        self.note_time(now);
        match input {
            Input::Datagram { from, channel, bytes } => self.receive(now, from, channel, &bytes, out),
            Input::Time => {}
            Input::OpenWriter(settings) => self.open(now, settings, true, out),
            Input::OpenReader(settings) => self.open(now, settings, false, out),
            Input::Close(entity) => self.close(now, entity),
            Input::Write { writer, sample } => self.write(now, writer, sample, out),
            Input::AssertLiveliness(entity) => self.assert_liveliness(now, entity),
            Input::Leave => {
                self.leave(now, out);
                return;
            }
        }
        self.settle(now, out);
    }

    /// Datagrams in the sockets of a process that stood still come in after this step: until then others are not given up.
    fn note_time(&mut self, now: Now) {
        let expected = self.due.map_or(now.steady, |due| due.max(self.last));
        let late = now.steady.saturating_sub(expected);
        if late >= LATE_MIN {
            self.discovery.stood_still(late);
        }
        self.last = now.steady;
    }

    fn open(&mut self, now: Now, settings: EndpointSettings, is_writer: bool, out: &mut Vec<Output>) {
        let Some(entity) = self.free_entity(&settings, is_writer) else { return };
        let role = if is_writer {
            Role::Writer { writer: Box::new(Writer::new(entity, &settings.qos)), is_awaited: false }
        } else {
            Role::Reader(Box::new(Reader::new(entity, &settings.qos, settings.without_history)))
        };
        self.discovery.announce(
            now,
            &EndpointData {
                guid: Guid::new(self.guid.prefix, entity),
                topic: settings.topic.clone(),
                qos: settings.qos.clone(),
                user_data: settings.user_data.clone(),
                unicast: Vec::new(),
                multicast: Vec::new(),
                has_other_locators: false,
            },
        );
        self.own.insert(entity, OwnEndpoint { settings, role });
        out.push(Output::Opened(entity));
        self.match_own(now, entity, out);
        self.timers.set(entity, Some(now.steady));
    }

    fn free_entity(&mut self, settings: &EndpointSettings, is_writer: bool) -> Option<EntityId> {
        for _ in 1..KEYS {
            self.key = self.key % (KEYS - 1) + 1;
            let of = if is_writer { EntityId::writer } else { EntityId::reader };
            let entity = of(self.key, settings.topic.keyed);
            if !self.own.contains_key(&entity) {
                return Some(entity);
            }
        }
        None
    }

    fn close(&mut self, now: Now, entity: EntityId) {
        let Some(own) = self.own.remove(&entity) else { return };
        if let Role::Reader(reader) = own.role {
            self.held = self.held.saturating_sub(reader.held());
        }
        self.timers.set(entity, None);
        self.unmatch_own(entity);
        self.discovery.withdraw(now, entity);
    }

    fn write(&mut self, now: Now, entity: EntityId, sample: OutgoingSample, out: &mut Vec<Output>) {
        let Some(OwnEndpoint { role: Role::Writer { writer, is_awaited }, settings }) = self.own.get_mut(&entity)
        else {
            return;
        };
        let sequence = writer.write(now, sample);
        if settings.qos.liveliness == LivelinessKind::ManualByParticipant {
            self.discovery.assert_manually(now);
        }
        *is_awaited = true;
        self.timers.set(entity, Some(now.steady));
        out.push(Output::Written { writer: entity, sequence });
    }

    fn assert_liveliness(&mut self, now: Now, entity: EntityId) {
        let Some(OwnEndpoint { role: Role::Writer { writer, .. }, settings }) = self.own.get_mut(&entity) else {
            return;
        };
        match settings.qos.liveliness {
            // The participant asserts it.
            LivelinessKind::Automatic => {}
            LivelinessKind::ManualByParticipant => self.discovery.assert_manually(now),
            LivelinessKind::ManualByTopic => {
                writer.assert_liveliness();
                self.timers.set(entity, Some(now.steady));
            }
        }
    }

    fn leave(&mut self, now: Now, out: &mut Vec<Output>) {
        let mut outgoing = Vec::new();
        self.discovery.leave(now, &mut outgoing);
        packing::pack(self.discovery.config(), outgoing, out);
        self.has_left = true;
        self.due = None;
    }

    /// Does what is due, and sends it.
    fn settle(&mut self, now: Now, out: &mut Vec<Output>) {
        let mut outgoing = Vec::new();
        let mut events = Vec::new();
        self.discovery.poll(now, &mut outgoing, &mut events);
        self.apply(now, events, out);
        for entity in self.timers.take_due(now.steady) {
            self.poll(now, entity, &mut outgoing, out);
        }
        packing::pack(self.discovery.config(), outgoing, out);
        self.due = self.discovery.deadline().into_iter().chain(self.timers.next()).min();
    }

    fn poll(&mut self, now: Now, entity: EntityId, outgoing: &mut Vec<Outgoing>, out: &mut Vec<Output>) {
        let Some(own) = self.own.get_mut(&entity) else { return };
        let deadline = match &mut own.role {
            Role::Writer { writer, is_awaited } => {
                writer.poll(now, outgoing);
                let is_acknowledged = writer.is_acknowledged();
                if *is_awaited && is_acknowledged {
                    out.push(Output::Acknowledged(entity));
                }
                *is_awaited = !is_acknowledged;
                writer.deadline()
            }
            Role::Reader(reader) => {
                let (mut delivered, before) = (Vec::new(), reader.held());
                reader.poll(now, outgoing, &mut delivered);
                self.held = self.held.saturating_sub(before).saturating_add(reader.held());
                let deadline = reader.deadline();
                self.deliver(entity, delivered, out);
                deadline
            }
        };
        self.timers.set(entity, deadline);
    }

    /// Applies changes of endpoints of others.
    fn apply(&mut self, now: Now, events: Vec<Event>, out: &mut Vec<Output>) {
        for event in events {
            match event {
                Event::Found(endpoint) => {
                    let guid = endpoint.guid;
                    out.push(Output::Found(endpoint));
                    self.match_other(now, guid, out);
                }
                Event::Moved(guid) => self.match_other(now, guid, out),
                Event::Gone(guid) => {
                    self.unmatch_other(now, guid, out);
                    out.push(Output::Gone(guid));
                }
                Event::Unreachable(participant) => out.push(Output::Unreachable(participant)),
                Event::NotUnreachable(guid) => out.push(Output::NotUnreachable(guid)),
                Event::Liveliness(change) => self.report_liveliness(change, out),
                Event::Resynchronized(writer) => {
                    self.counters.resynchronized += 1;
                    // The reader of discovery that reads it: its number says the same, as of the writer.
                    let EntityId([a, b, c, kind]) = writer.entity;
                    let reader = EntityId([a, b, c, kind & 0xc0 | 0x07]);
                    out.push(Output::Resynchronized { reader, writer });
                }
            }
        }
    }

    /// Readers share the limit of the participant.
    fn keep_limit(&mut self, now: Now, out: &mut Vec<Output>) {
        if self.held <= PARTICIPANT_BYTES_MAX {
            return;
        }
        let readers = self.own.iter_mut().filter_map(|(entity, own)| match &mut own.role {
            Role::Reader(reader) => Some((*entity, reader)),
            Role::Writer { .. } => None,
        });
        let mut readers: Vec<_> = readers.map(|(entity, reader)| (entity, reader, Vec::new())).collect();
        let mut sharing: Vec<_> = readers.iter_mut().map(|(_, reader, out)| (&mut ***reader, out)).collect();
        reader::share(now.steady, PARTICIPANT_BYTES_MAX, &mut sharing);
        self.held = readers.iter().map(|(_, reader, _)| reader.held()).sum();
        let delivered: Vec<_> = readers.into_iter().map(|(entity, _, delivered)| (entity, delivered)).collect();
        for (entity, delivered) in delivered {
            self.timers.set(entity, Some(now.steady));
            self.deliver(entity, delivered, out);
        }
    }

    /// The results of an own reader.
    fn deliver(&mut self, reader: EntityId, delivered: Vec<Delivered>, out: &mut Vec<Output>) {
        for delivered in delivered {
            match delivered {
                Delivered::Sample(sample) => out.push(Output::Sample { reader, sample }),
                Delivered::Lost { writer, count, reason } => {
                    out.push(Output::Lost { reader, writer, count, reason });
                }
                // Samples are carried, their instances are not followed.
                Delivered::Disposed { .. } => {}
                Delivered::Resynchronized { writer } => {
                    self.counters.resynchronized += 1;
                    out.push(Output::Resynchronized { reader, writer });
                }
                Delivered::DeadlineMissed { count } => out.push(Output::DeadlineMissed { reader, count }),
            }
        }
    }
}
