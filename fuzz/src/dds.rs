//! A DDS participant with matched endpoints, and what is done to it: for `rtps-datagrams`.

use bytes::Bytes;
use rtps::Participant;
use rtps::announcement::{EndpointData, ParticipantData};
use rtps::guid::{EntityId, Guid, GuidPrefix, SequenceNumber, VendorId};
use rtps::interface::{Channel, Config, EndpointSettings, Input, OutgoingSample, Output, TopicDescription};
use rtps::qos::{Durability, History, Qos, Reliability};
use rtps::time::Now;
use rtps::wire::submessage::{
    AckNack, Data, DataFrag, Gap, Heartbeat, HeartbeatFrag, InlineQos, NackFrag, NumberSet, Payload, Submessage,
};
use rtps::wire::write::DatagramBuilder;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

/// Where the prefix of the sender stands in a datagram.
const PREFIX: std::ops::Range<usize> = 8..20;
const MAGIC: [u8; 8] = [b'R', b'T', b'P', b'S', 2, 5, 1, 0x10];
/// Most datagrams of one step, without those that carry the history of a writer.
const DATAGRAMS_MAX: usize = 4096;
/// Most bytes of one step: each of the readers gets what a burst and a repair may have.
const BYTES_MAX: usize = 64 << 20;
/// Most steps that follow at once from a deadline.
const STEPS_AT_ONCE_MAX: usize = 1000;

/// The other participants: 1 and 2 are found and have endpoints of each kind, 3 is not known.
pub const OTHERS: u8 = 3;

/// An own participant and its time.
pub struct World {
    participant: Participant,
    steady: u64,
    writers: Vec<EntityId>,
    matched: Vec<(EntityId, Guid)>,
}

/// The kinds of endpoints: with or without repair, history and keys.
fn kinds() -> [(&'static str, Qos, bool); 4] {
    let qos = |reliability, durability, history| Qos { reliability, durability, history, ..Qos::default() };
    [
        ("rt/reliable", qos(Reliability::Reliable, Durability::Volatile, History::KeepLast(10)), false),
        ("rt/best_effort", qos(Reliability::BestEffort, Durability::Volatile, History::KeepLast(1)), false),
        ("rt/latched", qos(Reliability::Reliable, Durability::TransientLocal, History::KeepLast(3)), false),
        ("rt/keyed", qos(Reliability::Reliable, Durability::TransientLocal, History::KeepAll), true),
    ]
}

fn topic(name: &str, keyed: bool) -> TopicDescription {
    TopicDescription { name: name.to_owned(), type_name: "T".to_owned(), keyed }
}

fn prefix(other: u8) -> GuidPrefix {
    GuidPrefix([other; 12])
}

fn address(other: u8) -> SocketAddrV4 {
    SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, other), 7411)
}

fn data(writer: EntityId, sequence: i64, payload: Bytes) -> Submessage {
    let (reader, sequence) = (EntityId::UNKNOWN, SequenceNumber(sequence));
    let (inline_qos, payload) = (InlineQos::default(), Payload::Data(payload));
    Submessage::Data(Data { reader, writer, sequence, inline_qos, payload })
}

fn announcement(other: u8) -> Bytes {
    let data = ParticipantData {
        prefix: prefix(other),
        vendor: if other == 1 { VendorId::CYCLONE } else { VendorId::FAST_DDS },
        domain: Some(0),
        lease: Duration::from_secs(100),
        discovery_unicast: vec![address(other)],
        discovery_multicast: Vec::new(),
        data_unicast: vec![address(other)],
        data_multicast: Vec::new(),
        builtin_endpoints: 0xc3f,
        name: String::new(),
        user_data: Bytes::new(),
    };
    data.to_payload()
}

/// The endpoints that another participant announces, by this builtin writer.
fn endpoints(other: u8, are_writers: bool) -> Vec<Submessage> {
    let announcer = if are_writers { EntityId::PUBLICATIONS_WRITER } else { EntityId::SUBSCRIPTIONS_WRITER };
    let mut submessages = Vec::new();
    for (key, (name, qos, keyed)) in (1..).zip(kinds()) {
        let entity = if are_writers { EntityId::writer(key, keyed) } else { EntityId::reader(key, keyed) };
        let (user_data, unicast, multicast) = (Bytes::new(), Vec::new(), Vec::new());
        let guid = Guid::new(prefix(other), entity);
        let topic = topic(name, keyed);
        let endpoint = EndpointData { guid, topic, qos, user_data, unicast, multicast, has_other_locators: false };
        submessages.push(data(announcer, key.into(), endpoint.to_payload()));
    }
    submessages.push(Submessage::Heartbeat(Heartbeat {
        reader: EntityId::UNKNOWN,
        writer: announcer,
        first: SequenceNumber(1),
        last: SequenceNumber(4),
        count: 1,
        is_final: true,
        is_alive: false,
    }));
    submessages
}

/// A datagram of another participant.
#[must_use]
pub fn datagram(other: u8, submessages: &[Submessage]) -> Bytes {
    let mut builder = DatagramBuilder::new(prefix(other));
    submessages.iter().for_each(|submessage| builder.push(submessage));
    builder.finish()
}

/// Steps of `rtps-datagrams` in which matched writers and readers send what they may: samples, fragments, HEARTBEATs, GAPs, requests.
#[must_use]
pub fn conversations() -> Vec<Vec<u8>> {
    let reader = EntityId::UNKNOWN;
    let set = |base, numbers: std::ops::Range<i64>| {
        let mut set = NumberSet::new(base);
        for number in numbers {
            set.insert(number);
        }
        set
    };
    let mut all = Vec::new();
    for (key, (_, _, keyed)) in (1..).zip(kinds()) {
        let (writer, count, is_final) = (EntityId::writer(key, keyed), 1, false);
        let heartbeat = |first, last| {
            let (first, last) = (SequenceNumber(first), SequenceNumber(last));
            Submessage::Heartbeat(Heartbeat { reader, writer, first, last, count, is_final, is_alive: true })
        };
        let fragment = |first, sequence| {
            let (fragment_bytes, sample_bytes, is_key) = (100, 350, false);
            let payload = Bytes::from(vec![7; if first == 4 { 50 } else { 100 }]);
            let (sequence, inline_qos) = (SequenceNumber(sequence), InlineQos::default());
            Submessage::DataFrag(DataFrag {
                reader,
                writer,
                sequence,
                first,
                count: 1,
                fragment_bytes,
                sample_bytes,
                inline_qos,
                is_key,
                payload,
            })
        };
        let sample = |number| data(writer, number, Bytes::from_static(b"\0\x01\0\0data"));
        let gap = Submessage::Gap(Gap { reader, writer, start: SequenceNumber(4), list: set(6, 7..9) });
        // The own endpoints have the same keys, each with a reader before its writer.
        let (own, other) = (EntityId::writer(2 * key, keyed), EntityId::reader(key, keyed));
        let missing = set(1, 1..3);
        let acknack = Submessage::AckNack(AckNack { reader: other, writer: own, missing, count, is_final });
        let sequence = SequenceNumber(1);
        let nack = NackFrag { reader: other, writer: own, sequence, missing: set(1, 2..9), count };
        let last = HeartbeatFrag { reader, writer, sequence: SequenceNumber(9), last: 4, count };
        let datagrams = [
            vec![heartbeat(1, 0), sample(1), sample(3), heartbeat(1, 3)],
            vec![fragment(1, 2), fragment(3, 2), fragment(1, 9), Submessage::HeartbeatFrag(last)],
            vec![gap, heartbeat(5, 9), acknack, Submessage::NackFrag(nack)],
            vec![fragment(2, 2), fragment(4, 2), heartbeat(1 << 40, 1 << 41)],
            vec![sample(10), sample(11), sample(12), heartbeat(10, 12)],
        ];
        let mut steps = vec![5, u8::try_from(key).unwrap_or_default(), 0xff, 0];
        for submessages in datagrams {
            let datagram = datagram(1, &submessages);
            steps.extend([0, 3]);
            steps.extend(u16::try_from(datagram.len()).unwrap_or_default().to_le_bytes());
            steps.extend(datagram);
            steps.extend([6, 4, 0xff, 0x0f]);
        }
        all.push(steps);
    }
    all
}

impl Default for World {
    fn default() -> Self {
        Self::new()
    }
}

impl World {
    /// All endpoints are matched.
    ///
    /// # Panics
    /// If they are not.
    #[must_use]
    pub fn new() -> Self {
        let own = vec![Ipv4Addr::new(10, 0, 0, 1)];
        let config = Config {
            prefix: GuidPrefix([0xaa; 12]),
            domain: 0,
            participant_id: 0,
            lease: Duration::from_secs(10),
            addresses: own.clone(),
            host: own,
            static_peers: Vec::new(),
            multicast: true,
            name: "fuzzed".to_owned(),
            user_data: Bytes::new(),
        };
        let participant = Participant::new(config, Now { steady: 0, wall: 0 });
        let mut world = Self { participant, steady: 0, writers: Vec::new(), matched: Vec::new() };
        for (name, qos, keyed) in kinds() {
            let (topic, user_data) = (topic(name, keyed), Bytes::new());
            let settings = EndpointSettings { topic, qos, user_data, without_history: name == "rt/reliable" };
            world.step(Input::OpenReader(settings.clone()));
            world.step(Input::OpenWriter(settings));
        }
        for other in 1..=2 {
            world.receive(other, &datagram(other, &[data(EntityId::SPDP_WRITER, 1, announcement(other))]), 0);
            for are_writers in [true, false] {
                world.receive(other, &datagram(other, &endpoints(other, are_writers)), 1);
            }
        }
        assert_eq!(world.matched.len(), 16);
        world
    }

    /// Takes a datagram in, as if another participant had sent it: its name is put into the header. Shorter ones get a header.
    pub fn receive(&mut self, other: u8, bytes: &[u8], channel: u8) {
        let mut datagram = if bytes.starts_with(b"RTPS") && bytes.len() >= PREFIX.end {
            bytes.to_vec()
        } else {
            [&MAGIC[..], &[0; 12], bytes].concat()
        };
        datagram[PREFIX].copy_from_slice(&prefix(other).0);
        let channels =
            [Channel::DiscoveryUnicast, Channel::DataUnicast, Channel::DiscoveryMulticast, Channel::DataMulticast];
        let channel = channels[usize::from(channel) % channels.len()];
        self.step(Input::Datagram { from: address(other), channel, bytes: datagram.into() });
    }

    /// Writes a sample.
    pub fn write(&mut self, writer: u8, bytes: usize) {
        let writer = self.writers[usize::from(writer) % self.writers.len()];
        let sample = OutgoingSample { payload: vec![1; bytes].into(), timestamp: None, related: None };
        self.step(Input::Write { writer, sample });
    }

    /// Asserts the liveliness of a writer.
    pub fn assert_liveliness(&mut self, writer: u8) {
        let writer = self.writers[usize::from(writer) % self.writers.len()];
        self.step(Input::AssertLiveliness(writer));
    }

    /// Lets time pass, with all that is due meanwhile.
    ///
    /// # Panics
    /// If the participant does not rest.
    pub fn wait(&mut self, micros: u64) {
        let end = self.steady + micros;
        let (mut at_once, mut steps) = (0, 0);
        while let Some(due) = self.participant.deadline().filter(|due| *due <= end) {
            at_once = if due <= self.steady { at_once + 1 } else { 0 };
            assert!(at_once < STEPS_AT_ONCE_MAX, "the participant does not rest");
            self.steady = self.steady.max(due);
            self.step(Input::Time);
            steps += 1;
            if steps > STEPS_AT_ONCE_MAX {
                break;
            }
        }
        self.steady = end;
        self.step(Input::Time);
    }

    fn step(&mut self, input: Input) {
        let mut out = Vec::new();
        self.participant.step(Now { steady: self.steady, wall: self.steady }, input, &mut out);
        let (mut datagrams, mut bytes) = (0, 0);
        for output in out {
            match output {
                Output::Send { to, bytes: datagram } => {
                    assert!(!to.is_empty() && datagram.len() <= rtps::limits::DATAGRAM_BYTES_MAX);
                    datagrams += to.len();
                    bytes += to.len() * datagram.len();
                }
                Output::Opened(entity) if entity.is_writer() => self.writers.push(entity),
                Output::Matched { endpoint, other } => self.matched.push((endpoint, other)),
                Output::Unmatched { endpoint, other } => self.matched.retain(|pair| *pair != (endpoint, other)),
                Output::Sample { reader, sample } => {
                    assert!(
                        self.matched.contains(&(reader, sample.writer)),
                        "a sample of a writer that does not match"
                    );
                    assert!(sample.sequence > SequenceNumber::ZERO);
                    bytes += sample.payload.len();
                }
                Output::Lost { reader, writer, count, .. } => {
                    assert!(count > 0 && self.matched.contains(&(reader, writer)));
                }
                Output::Liveliness { reader, writer, .. } => assert!(self.matched.contains(&(reader, writer))),
                _ => {}
            }
        }
        assert!(datagrams <= DATAGRAMS_MAX && bytes <= BYTES_MAX, "{datagrams} datagrams, {bytes} bytes at once");
        let held_max = rtps::limits::PARTICIPANT_BYTES_MAX + 3 * rtps::limits::ANNOUNCEMENTS_BYTES_MAX;
        assert!(self.participant.held_bytes() <= held_max);
    }
}
