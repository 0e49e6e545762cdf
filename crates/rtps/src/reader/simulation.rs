//! A writer and readers on a link that loses, delays, doubles and reorders, in virtual time. Each seed is another run.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]

use super::Reader;
use crate::endpoint::{Delivered, Outgoing, Peer};
use crate::guid::{EntityId, Guid, GuidPrefix, SequenceNumber};
use crate::interface::OutgoingSample;
use crate::limits::{ASSEMBLY_BYTES_MAX, HISTORY_BYTES_MAX};
use crate::qos::{Durability, History, Qos, Reliability};
use crate::time::Now;
use crate::wire::submessage::{
    AckNack, Addressed, Data, DataFrag, Gap, Heartbeat, HeartbeatFrag, InlineQos, NackFrag, NumberSet, Payload,
    Submessage,
};
use crate::writer::Writer;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddrV4};

const WRITER: EntityId = EntityId([0, 0, 1, 3]);
const READER: EntityId = EntityId([0, 0, 1, 4]);
const WRITER_PREFIX: GuidPrefix = GuidPrefix([100; 12]);

/// xorshift64*
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) % bound
    }

    fn happens(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }

    /// A number as an attacker would choose it.
    fn number(&mut self) -> i64 {
        match self.below(6) {
            0 => i64::MAX - i64::try_from(self.below(3)).unwrap(),
            1 => i64::MIN + i64::try_from(self.below(3)).unwrap(),
            2 => (1 << 62) - 2 + i64::try_from(self.below(4)).unwrap(),
            3 => -1,
            _ => i64::try_from(self.below(200)).unwrap(),
        }
    }
}

fn address(number: u8) -> SocketAddrV4 {
    SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, number), 7411)
}

struct Listener {
    reader: Reader,
    prefix: GuidPrefix,
    peer: Peer,
    heard: Vec<(i64, usize)>,
    is_dead: bool,
}

struct World {
    random: Random,
    now: u64,
    loss: u64,
    writer: Writer,
    listeners: Vec<Listener>,
    /// By arrival: for which listener (none: the writer), from whom, and what.
    link: BTreeMap<(u64, u64), (Option<usize>, Addressed)>,
    sent: u64,
}

impl World {
    fn new(seed: u64, loss: u64, qos: &Qos) -> Self {
        let random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        let writer = Writer::new(WRITER, qos);
        Self { random, now: 0, loss, writer, listeners: Vec::new(), link: BTreeMap::new(), sent: 0 }
    }

    fn now(&self) -> Now {
        Now { steady: self.now, wall: 0 }
    }

    fn listen(&mut self, qos: &Qos, is_local: bool) -> usize {
        let number = u8::try_from(self.listeners.len() + 1).unwrap();
        let prefix = GuidPrefix([number; 12]);
        let is_reliable = qos.reliability == Reliability::Reliable;
        let is_durable = qos.durability != Durability::Volatile;
        let unicast = vec![address(number)];
        let guid = Guid::new(prefix, READER);
        let peer = Peer { guid, is_reliable, is_durable, unicast, is_local, is_fast_dds: false };
        let reader = Reader::new(READER, qos, false);
        self.listeners.push(Listener { reader, prefix, peer: peer.clone(), heard: Vec::new(), is_dead: false });
        self.writer.add_reader(self.now(), peer);
        self.listeners.len() - 1
    }

    fn match_writer(&mut self, listener: usize, is_durable: bool) {
        let guid = Guid::new(WRITER_PREFIX, WRITER);
        let unicast = vec![address(100)];
        let peer = Peer { guid, is_reliable: true, is_durable, unicast, is_local: false, is_fast_dds: false };
        let now = self.now();
        self.listeners[listener].reader.add_writer(now, peer);
    }

    fn send(&mut self, source: GuidPrefix, out: Vec<Outgoing>) {
        for message in out {
            for to in &message.to {
                let listener = self.listeners.iter().position(|listener| listener.peer.unicast.contains(to));
                for submessage in &message.submessages {
                    let copies = 1 + u64::from(self.random.happens(5));
                    for _ in 0..copies {
                        if self.random.happens(self.loss) {
                            continue;
                        }
                        let delay = if self.random.happens(10) { self.random.below(20_000) } else { 200 };
                        self.sent += 1;
                        let addressed = Addressed {
                            source,
                            destination: message.destination,
                            timestamp: message.timestamp,
                            submessage: submessage.clone(),
                        };
                        self.link.insert((self.now + delay, self.sent), (listener, addressed));
                    }
                }
            }
        }
    }

    /// Runs for this long.
    fn run(&mut self, micros: u64) {
        let end = self.now + micros;
        loop {
            let mut out = Vec::new();
            let now = self.now();
            self.writer.poll(now, &mut out);
            self.send(WRITER_PREFIX, out);
            for index in 0..self.listeners.len() {
                let mut out = Vec::new();
                let listener = &mut self.listeners[index];
                let prefix = listener.prefix;
                if !listener.is_dead {
                    listener.reader.poll(now, &mut out, &mut Vec::new());
                }
                self.send(prefix, out);
            }
            let readers = self.listeners.iter().filter(|listener| !listener.is_dead);
            let deadlines = readers.filter_map(|listener| listener.reader.deadline()).chain(self.writer.deadline());
            let arrival = self.link.keys().next().map(|(at, _)| *at);
            let Some(next) = deadlines.map(|due| due.max(self.now + 1)).chain(arrival).min() else { break };
            if next > end {
                break;
            }
            self.now = self.now.max(next);
            self.arrive();
        }
        self.now = end;
    }

    fn arrive(&mut self) {
        let now = self.now();
        while let Some(entry) = self.link.first_entry().filter(|entry| entry.key().0 <= now.steady) {
            let (listener, message) = entry.remove();
            let Some(listener) = listener else {
                self.writer.receive(now, message.source, &message.submessage);
                continue;
            };
            let listener = &mut self.listeners[listener];
            if listener.is_dead {
                continue;
            }
            let mut out = Vec::new();
            listener.reader.receive(now, &message, &mut out);
            assert!(listener.reader.held() <= ASSEMBLY_BYTES_MAX);
            for delivered in out {
                if let Delivered::Sample(sample) = delivered {
                    listener.heard.push((sample.sequence.0, sample.payload.len()));
                }
            }
        }
    }

    /// Writes a sample whose size follows from its number.
    fn write(&mut self, is_large: bool) -> (i64, usize) {
        let bytes = if is_large { 3000 + usize::try_from(self.random.below(400_000)).unwrap() } else { 40 };
        let sample = OutgoingSample { payload: Bytes::from(vec![1; bytes]), timestamp: None, related: None };
        (self.writer.write(self.now(), sample).0, bytes)
    }
}

fn qos(reliability: Reliability, durability: Durability, history: History) -> Qos {
    Qos { reliability, durability, history, ..Qos::default() }
}

#[test]
fn reliable_readers_get_every_sample_in_order_once_over_a_bad_link() {
    for seed in 0..60 {
        let reliable = qos(Reliability::Reliable, Durability::Volatile, History::KeepAll);
        let best_effort = qos(Reliability::BestEffort, Durability::Volatile, History::KeepAll);
        let mut world = World::new(seed, seed % 4 * 10, &reliable);
        for listener in
            [world.listen(&reliable, true), world.listen(&reliable, false), world.listen(&best_effort, false)]
        {
            world.match_writer(listener, false);
        }
        world.run(3_000_000);
        let mut written = Vec::new();
        for _ in 0..40 {
            let is_large = world.random.happens(20);
            written.push(world.write(is_large));
            let pause = world.random.below(30_000);
            world.run(pause);
        }
        world.run(60_000_000);
        assert_eq!(world.listeners[0].heard, written, "seed {seed}");
        assert_eq!(world.listeners[1].heard, written, "seed {seed}");
        assert!(world.listeners[2].heard.is_sorted_by(|a, b| a.0 < b.0));
        assert!(world.writer.is_acknowledged(), "seed {seed}");
        assert_eq!(world.writer.unacknowledged_bytes(), 0);
        // Nothing is due any more, on either side.
        assert_eq!((world.writer.deadline(), world.listeners[0].reader.deadline()), (None, None), "seed {seed}");
    }
}

#[test]
fn a_late_durable_reader_gets_the_depth_of_the_writer_and_what_follows() {
    for seed in 0..40 {
        let durable = qos(Reliability::Reliable, Durability::TransientLocal, History::KeepLast(5));
        let mut world = World::new(seed, 20, &durable);
        let mut written: Vec<_> = (0..20).map(|number| world.write(number % 6 == 0)).collect();
        world.run(1_000_000);
        let listener = world.listen(&durable, seed % 2 == 0);
        world.match_writer(listener, true);
        world.run(10_000_000);
        for _ in 0..5 {
            written.push(world.write(false));
            world.run(5_000_000);
        }
        assert_eq!(world.listeners[0].heard, written[15..], "seed {seed}");
    }
}

#[test]
fn a_dead_reader_does_not_hold_up_the_others_or_the_writer() {
    for seed in 0..20 {
        let reliable = qos(Reliability::Reliable, Durability::Volatile, History::KeepLast(10));
        let mut world = World::new(seed, 5, &reliable);
        for listener in [world.listen(&reliable, false), world.listen(&reliable, false)] {
            world.match_writer(listener, false);
        }
        world.run(2_000_000);
        world.listeners[1].is_dead = true;
        let mut written = Vec::new();
        for _ in 0..200 {
            written.push(world.write(false));
            world.run(100_000);
        }
        world.run(5_000_000);
        assert_eq!(world.listeners[0].heard, written, "seed {seed}");
        assert!(world.writer.unacknowledged_bytes() < HISTORY_BYTES_MAX / 100);
        // It comes back: it gets what the depth still has.
        world.listeners[1].is_dead = false;
        world.run(10_000_000);
        assert_eq!(world.listeners[1].heard, written[190..], "seed {seed}");
    }
}

#[test]
fn a_reader_of_a_fast_writer_with_a_small_depth_gets_growing_numbers() {
    for seed in 0..20 {
        let reliable = qos(Reliability::Reliable, Durability::Volatile, History::KeepLast(1));
        let mut world = World::new(seed, 20, &reliable);
        let listener = world.listen(&reliable, true);
        world.match_writer(listener, false);
        world.run(1_000_000);
        for _ in 0..300 {
            let is_large = world.random.happens(30);
            world.write(is_large);
            world.run(1000);
        }
        world.run(10_000_000);
        let heard = &world.listeners[0].heard;
        assert!(heard.is_sorted_by(|a, b| a.0 < b.0));
        assert_eq!(
            heard.last().map(|(number, _)| *number),
            Some(300),
            "the newest one is always repaired, seed {seed}"
        );
    }
}

/// A submessage of which nothing can be trusted.
fn forged(random: &mut Random) -> Submessage {
    let reader = if random.happens(50) { READER } else { EntityId::UNKNOWN };
    let writer = WRITER;
    let sequence = SequenceNumber(random.number());
    let count = i32::try_from(random.below(10)).unwrap();
    let bits = u32::try_from(random.below(600)).unwrap();
    let mut set = NumberSet { base: random.number(), bits, bitmap: [u32::MAX; 8] };
    set.bitmap[0] = u32::try_from(random.below(1 << 32)).unwrap();
    let is_final = random.happens(50);
    let inline_qos = InlineQos { status: u32::from(random.happens(10)), ..InlineQos::default() };
    match random.below(8) {
        0 => Submessage::Data(Data {
            reader,
            writer,
            sequence,
            inline_qos,
            payload: Payload::Data(Bytes::from(vec![9; 5])),
        }),
        1 => Submessage::Heartbeat(Heartbeat {
            reader,
            writer,
            first: SequenceNumber(random.number()),
            last: SequenceNumber(random.number()),
            count,
            is_final,
            is_alive: false,
        }),
        2 => Submessage::Gap(Gap { reader, writer, start: sequence, list: set }),
        3 => Submessage::HeartbeatFrag(HeartbeatFrag { reader, writer, sequence, last: u32::MAX, count }),
        4 => Submessage::AckNack(AckNack { reader: READER, writer, missing: set, count, is_final }),
        5 => Submessage::NackFrag(NackFrag { reader: READER, writer, sequence, missing: set, count }),
        _ => {
            let fragment_bytes = [0, 1, 256, 1344, u16::MAX][usize::try_from(random.below(5)).unwrap()];
            let sample_bytes = [0, 1, 1000, 16 << 20, u32::MAX][usize::try_from(random.below(5)).unwrap()];
            let first = [0, 1, 2, 100, u32::MAX][usize::try_from(random.below(5)).unwrap()];
            let count = [0, 1, 3, u16::MAX][usize::try_from(random.below(4)).unwrap()];
            let payload = Bytes::from(vec![1; usize::try_from(random.below(4000)).unwrap()]);
            let sequence =
                SequenceNumber(if random.happens(50) { sequence.0 } else { i64::try_from(random.below(20)).unwrap() });
            Submessage::DataFrag(DataFrag {
                reader,
                writer,
                sequence,
                first,
                count,
                fragment_bytes,
                sample_bytes,
                inline_qos,
                is_key: false,
                payload,
            })
        }
    }
}

#[test]
fn forged_submessages_neither_break_anything_nor_exceed_limits() {
    for seed in 0..60 {
        let reliable = qos(Reliability::Reliable, Durability::Volatile, History::KeepLast(10));
        let best_effort = qos(Reliability::BestEffort, Durability::Volatile, History::KeepLast(10));
        let mut world = World::new(seed, 0, &reliable);
        for listener in [world.listen(&reliable, false), world.listen(&best_effort, false)] {
            world.match_writer(listener, seed % 2 == 0);
        }
        let mut forger = Random(seed + 7);
        for step in 0..2000 {
            if step % 10 == 0 {
                world.write(false);
            }
            let submessage = forged(&mut forger);
            world.sent += 1;
            let source = WRITER_PREFIX;
            let message = Addressed { source, destination: GuidPrefix::UNKNOWN, timestamp: None, submessage };
            for listener in 0..2 {
                world.sent += 1;
                world.link.insert((world.now, world.sent), (Some(listener), message.clone()));
            }
            let message = Addressed { source: GuidPrefix([1; 12]), ..message };
            world.link.insert((world.now, 0), (None, message));
            world.run(500);
        }
        // The forger stops: what the writer writes is heard again.
        world.run(1_000_000);
        for listener in &mut world.listeners {
            listener.heard.clear();
        }
        for _ in 0..30 {
            world.write(false);
            world.run(50_000);
        }
        for (index, listener) in world.listeners.iter().enumerate() {
            let numbers: Vec<i64> = listener.heard.iter().map(|(number, _)| *number).collect();
            assert!(numbers.ends_with(&[226, 227, 228, 229, 230]), "seed {seed}, listener {index}: {numbers:?}");
        }
    }
}
