//! Announces this participant (SPDP, §8.5.3): a stateless best-effort writer.

use super::locators::{data_multicast, data_port, discovery_multicast, discovery_port, static_peers};
use crate::announcement::{ParticipantData, key_payload};
use crate::endpoint::Outgoing;
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber, VendorId};
use crate::interface::Config;
use crate::time::{Now, Ticks, micros};
use crate::wire::submessage::{Data, InlineQos, Payload, Submessage};
use bytes::Bytes;
use std::net::SocketAddrV4;

/// Announcements in one lease: four may be lost.
const ANNOUNCEMENTS_PER_LEASE: u64 = 5;
/// Shortest time between two announcements, microseconds.
const PERIOD_MIN: u64 = 20_000;
/// New participants that are answered at once. A stranger that makes up participants gets no more answers than this in a second.
const REPLIES_MAX: u64 = 64;
/// The time in which one more answer is allowed, microseconds.
const REPLY_PERIOD: u64 = 1_000_000 / REPLIES_MAX;

/// The value of `PID_BUILTIN_ENDPOINT_SET` (§9.3.2): each bit is a builtin endpoint that a participant has.
pub(crate) mod builtin {
    /// Its endpoints of SPDP: an announcer and a detector.
    pub(crate) const PARTICIPANT: u32 = 0b11;
    /// Announces its writers.
    pub(crate) const PUBLICATIONS_WRITER: u32 = 1 << 2;
    /// Receives announcements of writers.
    pub(crate) const PUBLICATIONS_READER: u32 = 1 << 3;
    /// Announces its readers.
    pub(crate) const SUBSCRIPTIONS_WRITER: u32 = 1 << 4;
    /// Receives announcements of readers.
    pub(crate) const SUBSCRIPTIONS_READER: u32 = 1 << 5;
    /// Asserts the liveliness of its writers.
    pub(crate) const LIVELINESS_WRITER: u32 = 1 << 10;
    /// Receives the liveliness of writers.
    pub(crate) const LIVELINESS_READER: u32 = 1 << 11;
    /// Those of this crate.
    pub(crate) const OWN: u32 = PARTICIPANT
        | PUBLICATIONS_WRITER
        | PUBLICATIONS_READER
        | SUBSCRIPTIONS_WRITER
        | SUBSCRIPTIONS_READER
        | LIVELINESS_WRITER
        | LIVELINESS_READER;
}

/// The bits that this participant sends as `SPDPdiscoveredParticipantData`.
fn participant_data(config: &Config) -> ParticipantData {
    let at = |port: Option<u16>| -> Vec<SocketAddrV4> {
        port.map(|port| config.addresses.iter().map(|ip| SocketAddrV4::new(*ip, port)).collect()).unwrap_or_default()
    };
    let group = |group: Option<SocketAddrV4>| group.filter(|_| config.multicast).into_iter().collect();
    ParticipantData {
        prefix: config.prefix,
        vendor: VendorId::OWN,
        domain: Some(u32::from(config.domain)),
        lease: config.lease,
        discovery_unicast: at(discovery_port(config.domain, config.participant_id)),
        discovery_multicast: group(discovery_multicast(config.domain)),
        data_unicast: at(data_port(config.domain, config.participant_id)),
        data_multicast: group(data_multicast(config.domain)),
        builtin_endpoints: builtin::OWN,
        name: config.name.clone(),
        user_data: config.user_data.clone(),
    }
}

/// Sends the announcements.
#[derive(Debug)]
pub(crate) struct Announcer {
    guid: Guid,
    payload: Bytes,
    /// The group, and the static peers.
    to: Vec<SocketAddrV4>,
    period: u64,
    next: u64,
    /// Grows with each announcement: RustDDS passes over a number that it has seen.
    sequence: SequenceNumber,
    /// When the answers of the past are paid off: each costs [`REPLY_PERIOD`].
    replies_until: u64,
}

impl Announcer {
    /// Announces at once.
    pub(crate) fn new(config: &Config, now: Now) -> Self {
        let group = discovery_multicast(config.domain).filter(|_| config.multicast);
        Self {
            guid: Guid::new(config.prefix, EntityId::PARTICIPANT),
            payload: participant_data(config).to_payload(),
            to: group.into_iter().chain(static_peers(config)).collect(),
            period: (micros(config.lease) / ANNOUNCEMENTS_PER_LEASE).max(PERIOD_MIN),
            next: now.steady,
            sequence: SequenceNumber::ZERO,
            replies_until: now.steady,
        }
    }

    /// When the next announcement is due.
    pub(crate) fn deadline(&self) -> u64 {
        self.next
    }

    /// The announcement that is due; `others` are participants that multicast does not reach.
    pub(crate) fn poll(&mut self, now: Now, others: impl Iterator<Item = SocketAddrV4>, out: &mut Vec<Outgoing>) {
        if now.steady < self.next {
            return;
        }
        self.next = now.steady.saturating_add(self.period);
        let payload = Payload::Data(self.payload.clone());
        self.send(now, self.with(others), GuidPrefix::UNKNOWN, payload, 0, out);
    }

    /// Answers a participant that was not known, so that it does not wait for the next announcement.
    pub(crate) fn reply(&mut self, now: Now, peer: GuidPrefix, to: &[SocketAddrV4], out: &mut Vec<Outgoing>) {
        let paid = self.replies_until.max(now.steady).saturating_add(REPLY_PERIOD);
        if paid > now.steady.saturating_add(REPLY_PERIOD * REPLIES_MAX) {
            return;
        }
        self.replies_until = paid;
        self.send(now, to.to_vec(), peer, Payload::Data(self.payload.clone()), 0, out);
    }

    /// Announces to all that this participant leaves: it is disposed of and unregistered.
    pub(crate) fn leave(&mut self, now: Now, others: impl Iterator<Item = SocketAddrV4>, out: &mut Vec<Outgoing>) {
        let payload = Payload::Key(key_payload(self.guid));
        self.send(now, self.with(others), GuidPrefix::UNKNOWN, payload, 3, out);
    }

    fn with(&self, others: impl Iterator<Item = SocketAddrV4>) -> Vec<SocketAddrV4> {
        self.to.iter().copied().chain(others.filter(|other| !self.to.contains(other))).collect()
    }

    fn send(
        &mut self,
        now: Now,
        to: Vec<SocketAddrV4>,
        destination: GuidPrefix,
        payload: Payload,
        status: u32,
        out: &mut Vec<Outgoing>,
    ) {
        if to.is_empty() {
            return;
        }
        self.sequence = self.sequence.next();
        // Fast DDS takes the key of what is disposed of from its hash.
        let key_hash = (status != 0).then(|| self.guid.to_bytes());
        out.push(Outgoing {
            to,
            destination,
            timestamp: Some(Ticks::from_micros(now.wall)),
            submessages: vec![Submessage::Data(Data {
                reader: EntityId::SPDP_READER,
                writer: EntityId::SPDP_WRITER,
                sequence: self.sequence,
                inline_qos: InlineQos { related: None, status, key_hash },
                payload,
            })],
        });
    }
}
