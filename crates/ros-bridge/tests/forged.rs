//! Datagrams made by hand, which a process of the bridge's host sends to its DDS: none of them costs more than it brings.

use std::{net::UdpSocket, time::Duration};
use testkit::own_network as network;

use crate::commands::{DEADLINE, next, numbered, rust_dds, topic, twist};
use ledger_gate::sample::{SAMPLE_BYTES_MAX, Sample};
use ros_bridge::{
    dds::{Participant, Reader, Writer},
    qos::{Durability, Qos, Reliability},
    queue::Limits,
};
use rustdds::{DomainParticipantBuilder, TopicKind};

const DOMAIN: u16 = 3;
/// Where the first participant of the domain listens for discovery.
const DISCOVERY: u16 = 7410 + 250 * DOMAIN;
/// How long a newcomer waits before it writes again.
const AGAIN: Duration = Duration::from_millis(200);
/// Participants of a test need less, and what is forged here claims more.
const RESIDENT_KIB_MAX: u64 = 256 * 1024;

const ACKNACK: u8 = 0x06;
const HEARTBEAT: u8 = 0x07;
const GAP: u8 = 0x08;
const NACK_FRAG: u8 = 0x12;
const DATA: u8 = 0x15;
const DATA_FRAG: u8 = 0x16;

/// A reader and a writer, as submessages name them.
type Ends = ([u8; 4], [u8; 4]);
const PARTICIPANTS: Ends = ([0, 1, 0, 0xc7], [0, 1, 0, 0xc2]);
const PUBLICATIONS: Ends = ([0, 0, 3, 0xc7], [0, 0, 3, 0xc2]);
const SUBSCRIPTIONS: Ends = ([0, 0, 4, 0xc7], [0, 0, 4, 0xc2]);
/// Every reader that knows the writer.
const ALL: [u8; 4] = [0; 4];
/// A set of two numbers that has the second one.
const SECOND_OF_TWO: [u8; 8] = [2, 0, 0, 0, 0, 0, 0, 0x40];

/// A sequence number: its higher half comes first.
fn sequence(number: i64) -> [u8; 8] {
    let [a, b, c, d, e, f, g, h] = number.to_le_bytes();
    [e, f, g, h, a, b, c, d]
}

/// The beginning of all submessages, and then these fields.
fn body((reader, writer): Ends, fields: &[&[u8]]) -> Vec<u8> {
    [&reader, &writer].into_iter().map(<[u8; 4]>::as_slice).chain(fields.iter().copied()).collect::<Vec<_>>().concat()
}

/// The first of the fragments of 1000 bytes of a sample that is said to have so many bytes.
fn fragment(ends: Ends, number: i64, sample_bytes: u32) -> Vec<u8> {
    let sizes =
        [1_u32.to_le_bytes().as_slice(), &[1, 0], &1000_u16.to_le_bytes(), &sample_bytes.to_le_bytes()].concat();
    let fields = body(ends, &[&sequence(number), &sizes, &[7_u8; 1000]]);
    [[0_u8, 0, 28, 0].as_slice(), &fields].concat()
}

/// Sends to the discovery of the first participant of the domain.
struct Forger(UdpSocket);

impl Forger {
    fn new() -> Self {
        Self(UdpSocket::bind("127.0.0.1:0").unwrap())
    }

    /// Sends an RTPS message of one submessage, little endian, in the name of the participant with this prefix.
    fn send(&self, prefix: [u8; 12], kind: u8, body: &[u8]) {
        // With a payload, if it is a sample.
        let flags = if kind == DATA { 5 } else { 1 };
        let length = u16::try_from(body.len()).unwrap().to_le_bytes();
        let message = [b"RTPS\x02\x03\x01\x12".as_slice(), &prefix, &[kind, flags], &length, body].concat();
        assert_eq!(self.0.send_to(&message, ("127.0.0.1", DISCOVERY)).unwrap(), message.len());
    }
}

/// Two participants that hear each other.
struct Scene {
    reader: Reader,
    writer: Writer,
    _participants: [Participant; 2],
    /// The writer, as `reader` knows it.
    prefix: [u8; 12],
    known: Ends,
}

impl Scene {
    async fn begin() -> Self {
        let (here, there) =
            (Participant::open(DOMAIN, "here").await.unwrap(), Participant::open(DOMAIN, "there").await.unwrap());
        let mut reader = here.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
        let writer = there.writer(&topic(), &twist(), &Qos::default()).unwrap();
        let heard = async {
            assert!(reader.matched().at_least(1).await && writer.matched().at_least(1).await);
        };
        tokio::time::timeout(DEADLINE, heard).await.unwrap();
        writer.write(&numbered(1)).unwrap();
        let source = next(&mut reader).await.source;
        let (prefix, entity) = source.split_first_chunk::<12>().unwrap();
        let (prefix, known) = (*prefix, (ALL, entity.try_into().unwrap()));
        Self { reader, writer, _participants: [here, there], prefix, known }
    }
}

/// The reader finds a newcomer and hears it. All that was forged before is handled then, as it came to the same socket. Answers
/// with the samples that came before.
async fn hears_a_newcomer(reader: &mut Reader) -> Vec<Sample> {
    let known = reader.matched().now().matched;
    let newcomer = Participant::open(DOMAIN, "newcomer").await.unwrap();
    let writer = newcomer.writer(&topic(), &twist(), &Qos::default()).unwrap();
    let mut before = Vec::new();
    let heard = async {
        assert!(reader.matched().at_least(known + 1).await && writer.matched().at_least(1).await);
        loop {
            // A reader that is best effort may miss one.
            writer.write(&numbered(9)).unwrap();
            let Ok(heard) = tokio::time::timeout(AGAIN, reader.next()).await else { continue };
            let sample = heard.unwrap().sample;
            if sample == numbered(9) {
                return;
            }
            before.push(sample);
        }
    };
    tokio::time::timeout(DEADLINE, heard).await.unwrap();
    before
}

/// The most memory that this process, which runs one test, has had resident.
fn assert_little_memory() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")).unwrap();
    let peak: u64 = peak.parse().unwrap();
    assert!(peak < RESIDENT_KIB_MAX, "{peak} KiB were resident");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stranger_that_announces_huge_samples_reserves_no_memory() {
    if !network::isolated(&|| ()) {
        return;
    }
    let here = Participant::open(DOMAIN, "here").await.unwrap();
    let mut reader = here.reader(&topic(), &twist(), &Qos::default(), Limits::default()).unwrap();
    let forger = Forger::new();
    for sample_bytes in [u32::MAX, u32::try_from(SAMPLE_BYTES_MAX).unwrap()] {
        for stranger in 1..=20 {
            for ends in [PARTICIPANTS, PUBLICATIONS] {
                forger.send([stranger; 12], DATA_FRAG, &fragment(ends, 1, sample_bytes));
            }
        }
    }
    hears_a_newcomer(&mut reader).await;
    assert_little_memory();
}

#[tokio::test(flavor = "multi_thread")]
async fn incomplete_samples_of_a_known_writer_take_as_much_memory_as_came_of_them() {
    if !network::isolated(&|| ()) {
        return;
    }
    let Scene { mut reader, writer, prefix, known, _participants } = Scene::begin().await;
    let forger = Forger::new();
    for number in 1001..=1100 {
        forger.send(prefix, DATA_FRAG, &fragment(known, number, u32::try_from(SAMPLE_BYTES_MAX).unwrap()));
        forger.send(prefix, DATA_FRAG, &fragment(known, number + 1000, u32::MAX));
    }
    hears_a_newcomer(&mut reader).await;
    assert_little_memory();
    writer.write(&numbered(2)).unwrap();
    assert_eq!(next(&mut reader).await.sample, numbered(2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_heartbeat_and_a_gap_over_countless_samples_are_handled_at_once() {
    if !network::isolated(&|| ()) {
        return;
    }
    let Scene { mut reader, writer: _writer, prefix, known, _participants } = Scene::begin().await;
    let forger = Forger::new();
    let heartbeat = body(known, &[&sequence(1), &sequence(1 << 27), &1000_i32.to_le_bytes()]);
    forger.send(prefix, HEARTBEAT, &heartbeat);
    let gap = body(known, &[&sequence(1000), &sequence(1 << 25), &[0_u8; 4]]);
    forger.send(prefix, GAP, &gap);
    hears_a_newcomer(&mut reader).await;
    assert_little_memory();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_writer_that_nobody_has_announced_is_not_heard_whatever_it_is_called() {
    if !network::isolated(&|| ()) {
        return;
    }
    let Scene { reader: _reader, writer: _writer, known, _participants: [here, _there], .. } = Scene::begin().await;
    // A reliable reader gives out no sample whose place among those of its writer it does not know.
    let qos = Qos { reliability: Reliability::BestEffort, ..Qos::default() };
    let mut reader = here.reader(&topic(), &twist(), &qos, Limits::default()).unwrap();
    let forger = Forger::new();
    // A reader is known by a number and its kind. The writer calls itself one of discovery, or of a user.
    for (number, kind) in (0..=u8::MAX).flat_map(|number| [(number, 4), (number, 7)]) {
        for writer in [PUBLICATIONS.1, known.1] {
            let fields = body(([0, 0, number, kind], writer), &[&sequence(7), numbered(666).wire()]);
            forger.send([5; 12], DATA, &[[0_u8, 0, 16, 0].as_slice(), &fields].concat());
        }
    }
    assert_eq!(hears_a_newcomer(&mut reader).await, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn numbers_at_the_end_of_their_range_do_not_end_dds() {
    if !network::isolated(&|| ()) {
        return;
    }
    let Scene { mut reader, writer: _writer, prefix, known, _participants } = Scene::begin().await;
    let forger = Forger::new();
    let (last, count) = (sequence(i64::MAX), 1000_i32.to_le_bytes());
    forger.send(prefix, HEARTBEAT, &body(known, &[&last, &last, &count]));
    forger.send(prefix, GAP, &body(known, &[&sequence(1), &last, &SECOND_OF_TWO]));
    forger.send([1; 12], ACKNACK, &body(PUBLICATIONS, &[&last, &SECOND_OF_TWO, &count]));
    let fragments = body(SUBSCRIPTIONS, &[&sequence(1), &u32::MAX.to_le_bytes(), &SECOND_OF_TWO, &count]);
    forger.send(prefix, NACK_FRAG, &fragments);
    hears_a_newcomer(&mut reader).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sample_above_16_mib_is_passed_over_and_the_next_one_comes() {
    if !network::isolated(&|| ()) {
        return;
    }
    let qos = Qos { durability: Durability::TransientLocal, depth: 10, ..Qos::default() };
    let here = Participant::open(DOMAIN, "here").await.unwrap();
    let mut reader = here.reader(&topic(), &twist(), &qos, Limits::default()).unwrap();
    // A bridge writes no such sample, so this is somebody else.
    let there = DomainParticipantBuilder::new(DOMAIN).build().unwrap();
    let policies = rust_dds(&qos);
    let dds_topic = there.create_topic(topic().dds(), twist().dds(), &policies, TopicKind::NoKey).unwrap();
    let publisher = there.create_publisher(&policies).unwrap();
    let writer = publisher.create_datawriter_no_key_cdr::<Vec<u8>>(&dds_topic, Some(policies)).unwrap();
    assert!(writer.write(vec![1; SAMPLE_BYTES_MAX], None).is_ok());
    assert!(writer.write(vec![2; 4], None).is_ok());
    assert_eq!(next(&mut reader).await.sample.body(), [4_u8, 0, 0, 0, 2, 2, 2, 2].as_slice());
    assert_eq!(reader.dropped(), 0, "the large one was never assembled");
}
