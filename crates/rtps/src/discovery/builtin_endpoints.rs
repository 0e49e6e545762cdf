//! The builtin endpoints of this participant that are reliable: writers and readers of announcements (SEDP, §8.5.4) and of liveliness
//! (§8.4.13).

use super::announcer::builtin;
use super::liveliness::Liveliness;
use crate::announcement::{EndpointData, key_payload};
use crate::endpoint::{Delivered, Outgoing, Peer};
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::interface::OutgoingSample;
use crate::limits::{ANNOUNCEMENTS_BYTES_MAX, ANNOUNCEMENTS_OF_PARTICIPANT_BYTES_MAX};
use crate::qos::{Durability, History, Qos, Reliability};
use crate::reader::Reader;
use crate::time::{Now, Ticks};
use crate::timers::Timers;
use crate::wire::submessage::{Addressed, Gap, NumberSet, Payload, Submessage};
use crate::writer::Writer;
use bytes::Bytes;
use std::collections::{BTreeMap, VecDeque};

/// Largest announcement of an endpoint that is put together of fragments, bytes. A larger one is passed over. Type information of a
/// message with many fields, which Fast DDS and CycloneDDS add, is some kilobytes.
pub(crate) const ANNOUNCEMENT_BYTES_MAX: u32 = 64 * 1024;
/// Ends of own endpoints that are kept for participants that have not heard them, or come back. A participant may close this many at
/// once.
const ENDS_MAX: usize = 4096;
/// Shortest time between two repetitions of ends, microseconds: made-up participants that come and go cost no more.
const REPEAT_PERIOD: u64 = 1_000_000;
/// Participants that were given up, and may come back.
const LOST_MAX: usize = 512;
/// Disposed and unregistered (`PID_STATUS_INFO`): an endpoint has been closed.
const CLOSED: u32 = 3;

/// A pair of builtin endpoints: own readers of others' writers, and own writers for others' readers.
struct Pair {
    writer: EntityId,
    reader: EntityId,
    /// The bits by which a participant says that it has them.
    has_writer: u32,
    has_reader: u32,
}

const PAIRS: [Pair; 3] = [
    Pair {
        writer: EntityId::PUBLICATIONS_WRITER,
        reader: EntityId::PUBLICATIONS_READER,
        has_writer: builtin::PUBLICATIONS_WRITER,
        has_reader: builtin::PUBLICATIONS_READER,
    },
    Pair {
        writer: EntityId::SUBSCRIPTIONS_WRITER,
        reader: EntityId::SUBSCRIPTIONS_READER,
        has_writer: builtin::SUBSCRIPTIONS_WRITER,
        has_reader: builtin::SUBSCRIPTIONS_READER,
    },
    Pair {
        writer: EntityId::LIVELINESS_WRITER,
        reader: EntityId::LIVELINESS_READER,
        has_writer: builtin::LIVELINESS_WRITER,
        has_reader: builtin::LIVELINESS_READER,
    },
];

/// An own endpoint that was closed.
#[derive(Debug)]
struct End {
    at: u64,
    entity: EntityId,
    /// The sample that says so.
    sequence: SequenceNumber,
}

/// When ends are announced again, and since which moment.
#[derive(Clone, Copy, Debug)]
struct Repetition {
    due: u64,
    since: u64,
}

/// The builtin endpoints.
#[derive(Debug)]
pub(crate) struct BuiltinEndpoints {
    prefix: GuidPrefix,
    writers: BTreeMap<EntityId, Writer>,
    readers: BTreeMap<EntityId, Reader>,
    /// The current announcement of each own endpoint. Invariant: the writers of announcements keep these and no others, and those of
    /// `ends` that not all have received.
    announced: BTreeMap<EntityId, SequenceNumber>,
    liveliness: Liveliness,
    /// The oldest first, at most [`ENDS_MAX`].
    ends: VecDeque<End>,
    repetition: Option<Repetition>,
    /// When ends were announced again last.
    repeated: Option<u64>,
    /// Participants that were silent, and since when: they may not know that, and keep what they heard before. At most [`LOST_MAX`].
    lost: BTreeMap<GuidPrefix, u64>,
    timers: Timers<EntityId>,
}

impl BuiltinEndpoints {
    pub(crate) fn new(prefix: GuidPrefix) -> Self {
        let qos = |history| Qos {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            history,
            ..Qos::default()
        };
        let history = |writer| match writer {
            // The newest message of each kind.
            EntityId::LIVELINESS_WRITER => History::KeepLast(2),
            // What is over is forgotten one by one.
            _ => History::KeepAll,
        };
        let reader = |entity| {
            Reader::new(entity, &qos(History::KeepAll), false)
                .with_room(ANNOUNCEMENTS_OF_PARTICIPANT_BYTES_MAX, ANNOUNCEMENTS_BYTES_MAX)
        };
        let writers = PAIRS.iter().map(|pair| (pair.writer, Writer::new(pair.writer, &qos(history(pair.writer)))));
        let readers = PAIRS.iter().map(|pair| (pair.reader, reader(pair.reader)));
        Self {
            prefix,
            writers: writers.collect(),
            readers: readers.collect(),
            announced: BTreeMap::new(),
            liveliness: Liveliness::default(),
            ends: VecDeque::new(),
            repetition: None,
            repeated: None,
            lost: BTreeMap::new(),
            timers: Timers::default(),
        }
    }

    /// A participant was found, or its address has changed. `peer`: its address; the GUID is replaced.
    pub(crate) fn add_participant(&mut self, now: Now, peer: &Peer, endpoints: u32) {
        let prefix = peer.guid.prefix;
        if let Some(since) = self.lost.remove(&prefix) {
            let due = self.repeated.map_or(now.steady, |at| at.saturating_add(REPEAT_PERIOD).max(now.steady));
            let since = self.repetition.map_or(since, |other| other.since.min(since));
            self.repetition = Some(Repetition { due, since });
        }
        let of = |entity| Peer { guid: Guid::new(prefix, entity), ..peer.clone() };
        for pair in &PAIRS {
            if let Some(writer) = self.writers.get_mut(&pair.writer).filter(|_| endpoints & pair.has_reader != 0) {
                writer.add_reader(now, of(pair.reader));
                self.timers.set(pair.writer, Some(now.steady));
            }
            if let Some(reader) = self.readers.get_mut(&pair.reader).filter(|_| endpoints & pair.has_writer != 0) {
                reader.add_writer(now, of(pair.writer));
                self.timers.set(pair.reader, Some(now.steady));
            }
        }
    }

    /// A participant has gone: what is known of it, and what it has acknowledged, is forgotten.
    pub(crate) fn remove_participant(&mut self, now: Now, prefix: GuidPrefix) {
        for pair in &PAIRS {
            if let Some(writer) = self.writers.get_mut(&pair.writer) {
                writer.remove_reader(Guid::new(prefix, pair.reader));
                self.timers.set(pair.writer, Some(now.steady));
            }
            if let Some(reader) = self.readers.get_mut(&pair.reader) {
                reader.remove_writer(Guid::new(prefix, pair.writer));
                self.timers.set(pair.reader, Some(now.steady));
            }
        }
    }

    /// A participant has gone because it was silent. The ends of endpoints that it has not heard are no longer kept for it.
    pub(crate) fn lose_participant(&mut self, now: Now, prefix: GuidPrefix, since: u64) {
        self.remove_participant(now, prefix);
        if self.lost.len() >= LOST_MAX {
            let oldest = self.lost.iter().min_by_key(|(_, since)| **since).map(|(prefix, _)| *prefix);
            oldest.and_then(|prefix| self.lost.remove(&prefix));
        }
        self.lost.insert(prefix, since);
    }

    /// Announces again which endpoints have been closed since a moment. Repeating it changes nothing.
    fn repeat_ends(&mut self, now: Now) {
        let Some(Repetition { since, .. }) = self.repetition.take_if(|repetition| repetition.due <= now.steady) else {
            return;
        };
        self.repeated = Some(now.steady);
        let mut ends = std::mem::take(&mut self.ends);
        // The key of an endpoint that is open again has been closed before.
        let is_over = |end: &&mut End| end.at >= since && !self.announced.contains_key(&end.entity);
        let over: Vec<&mut End> = ends.iter_mut().filter(is_over).collect();
        for end in over {
            self.forget_sample(end.entity, end.sequence);
            end.sequence = self.end(now, end.entity).unwrap_or(end.sequence);
        }
        self.ends = ends;
    }

    fn end(&mut self, now: Now, entity: EntityId) -> Option<SequenceNumber> {
        let guid = Guid::new(self.prefix, entity);
        self.timers.set(announcer(entity), Some(now.steady));
        let writer = self.writers.get_mut(&announcer(entity))?;
        Some(writer.dispose(now, Payload::Key(key_payload(guid)), guid.to_bytes(), CLOSED))
    }

    fn forget_sample(&mut self, entity: EntityId, sequence: SequenceNumber) {
        if let Some(writer) = self.writers.get_mut(&announcer(entity)) {
            writer.forget(sequence);
        }
    }

    /// A submessage of a participant that is known.
    pub(crate) fn receive(&mut self, now: Now, message: &Addressed, out: &mut Vec<Delivered>) {
        match &message.submessage {
            Submessage::AckNack(acknack) => self.receive_by_writer(now, acknack.writer, message),
            Submessage::NackFrag(nack) => self.receive_by_writer(now, nack.writer, message),
            Submessage::DataFrag(fragment) if fragment.sample_bytes > ANNOUNCEMENT_BYTES_MAX => {
                // The same as if it had gone: the reader does not wait for it.
                let list = NumberSet::new(fragment.sequence.next().0);
                let (reader, writer, start) = (fragment.reader, fragment.writer, fragment.sequence);
                let submessage = Submessage::Gap(Gap { reader, writer, start, list });
                self.receive_by_reader(now, writer, &Addressed { submessage, ..message.clone() }, out);
            }
            Submessage::Data(data) => self.receive_by_reader(now, data.writer, message, out),
            Submessage::DataFrag(fragment) => self.receive_by_reader(now, fragment.writer, message, out),
            Submessage::Heartbeat(heartbeat) => self.receive_by_reader(now, heartbeat.writer, message, out),
            Submessage::HeartbeatFrag(heartbeat) => self.receive_by_reader(now, heartbeat.writer, message, out),
            Submessage::Gap(gap) => self.receive_by_reader(now, gap.writer, message, out),
        }
    }

    fn receive_by_writer(&mut self, now: Now, writer: EntityId, message: &Addressed) {
        if let Some(own) = self.writers.get_mut(&writer) {
            own.receive(now, message.source, &message.submessage);
            self.timers.set(writer, Some(now.steady));
        }
    }

    fn receive_by_reader(&mut self, now: Now, writer: EntityId, message: &Addressed, out: &mut Vec<Delivered>) {
        let Some(pair) = PAIRS.iter().find(|pair| pair.writer == writer) else { return };
        if let Some(own) = self.readers.get_mut(&pair.reader) {
            own.receive(now, message, out);
            self.timers.set(pair.reader, Some(now.steady));
        }
    }

    /// Announces an own endpoint. Its announcements from before are over.
    pub(crate) fn announce(&mut self, now: Now, data: &EndpointData) {
        let entity = data.guid.entity;
        let timestamp = Some(Ticks::from_micros(now.wall));
        let sample = OutgoingSample { payload: data.to_payload(), timestamp, related: None };
        let Some(sequence) = self.write(now, announcer(entity), sample) else { return };
        self.forget(entity, Some(sequence));
        let qos = &data.qos;
        if entity.is_writer()
            && let Some(lease) = qos.liveliness_lease.to_micros()
        {
            self.liveliness.add(now, entity, qos.liveliness, lease);
        }
    }

    /// An own writer of kind MANUAL_BY_PARTICIPANT has written, or is asserted.
    pub(crate) fn assert_manually(&mut self, now: Now) {
        self.liveliness.assert_manually(now);
    }

    /// An own endpoint has been closed: its announcement is replaced by its end.
    pub(crate) fn withdraw(&mut self, now: Now, entity: EntityId) {
        self.forget(entity, None);
        self.liveliness.remove(entity);
        let Some(sequence) = self.end(now, entity) else { return };
        self.ends.push_back(End { at: now.steady, entity, sequence });
        if self.ends.len() > ENDS_MAX
            && let Some(End { entity, sequence, .. }) = self.ends.pop_front()
        {
            self.forget_sample(entity, sequence);
        }
    }

    /// The own endpoints that are announced.
    pub(crate) fn announced(&self) -> impl Iterator<Item = EntityId> + '_ {
        self.announced.keys().copied()
    }

    fn forget(&mut self, entity: EntityId, next: Option<SequenceNumber>) {
        let before = match next {
            Some(sequence) => self.announced.insert(entity, sequence),
            None => self.announced.remove(&entity),
        };
        if let Some(before) = before {
            self.forget_sample(entity, before);
        }
    }

    fn write(&mut self, now: Now, writer: EntityId, sample: OutgoingSample) -> Option<SequenceNumber> {
        self.timers.set(writer, Some(now.steady));
        Some(self.writers.get_mut(&writer)?.write(now, sample))
    }

    /// Puts out what is due.
    pub(crate) fn poll(&mut self, now: Now, out: &mut Vec<Outgoing>) {
        self.repeat_ends(now);
        for payload in self.liveliness.poll(now, self.prefix) {
            self.assert_liveliness(now, payload);
        }
        for entity in self.timers.take_due(now.steady) {
            if let Some(writer) = self.writers.get_mut(&entity) {
                writer.poll(now, out);
                self.timers.set(entity, writer.deadline());
            }
            if let Some(reader) = self.readers.get_mut(&entity) {
                // All are reliable, without a deadline: nothing is delivered by time.
                reader.poll(now, out, &mut Vec::new());
                self.timers.set(entity, reader.deadline());
            }
        }
    }

    fn assert_liveliness(&mut self, now: Now, payload: Bytes) {
        let timestamp = Some(Ticks::from_micros(now.wall));
        self.write(now, EntityId::LIVELINESS_WRITER, OutgoingSample { payload, timestamp, related: None });
    }

    /// Bytes of announcements that wait.
    pub(crate) fn held(&self) -> usize {
        self.readers.values().map(Reader::held).sum()
    }

    /// When [`BuiltinEndpoints::poll`] has something to do next.
    pub(crate) fn deadline(&self) -> Option<u64> {
        let repetition = self.repetition.map(|repetition| repetition.due);
        [self.timers.next(), self.liveliness.deadline(), repetition].into_iter().flatten().min()
    }
}

/// The builtin writer that announces an own endpoint.
fn announcer(entity: EntityId) -> EntityId {
    if entity.is_writer() { EntityId::PUBLICATIONS_WRITER } else { EntityId::SUBSCRIPTIONS_WRITER }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interface::TopicDescription;
    use std::net::{Ipv4Addr, SocketAddrV4};

    #[test]
    fn a_participant_that_acknowledges_nothing_or_comes_and_goes_does_not_make_announcements_grow() {
        let mut builtin = BuiltinEndpoints::new(GuidPrefix([1; 12]));
        let peer = |last| Peer {
            guid: Guid::new(GuidPrefix([last; 12]), EntityId::PARTICIPANT),
            is_reliable: true,
            is_durable: true,
            unicast: vec![SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410)],
            is_local: true,
            is_fast_dds: false,
        };
        builtin.add_participant(Now::default(), &peer(2), builtin::OWN);
        let mut most = 0;
        for key in 1..20_000 {
            let now = Now { steady: u64::from(key) * 1_000, wall: 0 };
            let guid = Guid::new(GuidPrefix([1; 12]), EntityId::writer(key, false));
            let topic = TopicDescription { name: "rt/t".into(), type_name: "T".into(), keyed: false };
            let (qos, user_data, unicast, multicast) = (Qos::default(), Bytes::new(), Vec::new(), Vec::new());
            let data = EndpointData { guid, topic, qos, user_data, unicast, multicast, has_other_locators: false };
            builtin.announce(now, &data);
            builtin.withdraw(now, guid.entity);
            builtin.lose_participant(now, GuidPrefix([3; 12]), 0);
            builtin.add_participant(now, &peer(3), builtin::OWN);
            builtin.poll(now, &mut Vec::new());
            if key % 500 == 0 {
                most = most.max(builtin.writers.values().map(Writer::unacknowledged_bytes).sum());
            }
        }
        assert!((ENDS_MAX * 100..ENDS_MAX * 400).contains(&most), "{most} bytes");
        assert_eq!(builtin.ends.len(), ENDS_MAX);
    }
}
