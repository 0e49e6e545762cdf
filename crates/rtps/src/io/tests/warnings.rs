//! Reports to handles, and log lines: losses, forged messages, liveliness.

use super::*;
use crate::discovery::locators::data_port;
use crate::interface::WriterLosses;
use crate::limits::SAMPLE_BYTES_MAX;
use crate::qos::{History, LivelinessKind};
use crate::time::Ticks;
use crate::wire::submessage::{Heartbeat, Submessage};
use crate::wire::write::DatagramBuilder;
use std::fmt::{Debug, Write as _};
use std::net::UdpSocket;
use std::sync::{Mutex, PoisonError};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::subscriber::{DefaultGuard, set_default};
use tracing::{Event, Level, Metadata, Subscriber};

/// The warnings of this thread.
#[derive(Clone, Default)]
struct Warnings(Arc<Mutex<Vec<String>>>);

impl Warnings {
    fn begin() -> (Self, DefaultGuard) {
        let warnings = Self::default();
        (warnings.clone(), set_default(warnings))
    }

    fn with(&self, text: &str) -> Vec<String> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.iter().filter(|line| line.contains(text)).cloned().collect()
    }
}

struct Line(String);

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        write!(self.0, "{}={value:?} ", field.name()).unwrap();
    }
}

impl Subscriber for Warnings {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= Level::WARN
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut line = Line(String::new());
        event.record(&mut line);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(line.0);
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

/// Sends a datagram to all participants of a domain on this host.
fn inject(domain: u16, datagram: &[u8]) {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    for participant in 0..4 {
        socket.send_to(datagram, (Ipv4Addr::LOCALHOST, data_port(domain, participant).unwrap())).unwrap();
    }
}

/// Waits until this holds.
async fn until(holds: impl Fn() -> bool) {
    let wait = async {
        while !holds() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    timeout(LONG, wait).await.unwrap();
}

#[tokio::test]
async fn a_forged_heartbeat_does_not_make_a_reader_deaf_and_is_warned_of_once() {
    let (warnings, _guard) = Warnings::begin();
    let [first, second] = [join(225).await, join(225).await];
    let writer = first.writer(endpoint()).unwrap();
    let mut reader = second.reader(endpoint(), LIMITS).unwrap();
    matched(reader.matches(), 1).await;
    matched(writer.matches(), 1).await;
    for number in 1..=5 {
        writer.write(sample(vec![0; 8])).unwrap();
        assert_eq!(timeout(LONG, reader.next()).await.unwrap().unwrap().sequence, SequenceNumber(number));
    }
    let mut forged = DatagramBuilder::new(writer.guid().prefix);
    forged.push(&Submessage::Heartbeat(Heartbeat {
        reader: crate::guid::EntityId::UNKNOWN,
        writer: writer.guid().entity,
        first: SequenceNumber(1 << 40),
        last: SequenceNumber(1 << 41),
        count: 1 << 30,
        is_final: true,
        is_alive: false,
    }));
    inject(225, &forged.finish());
    until(|| !reader.losses().lost.is_empty()).await;
    // It is heard again, and stays so.
    let again = async {
        for _ in 0..5 {
            while writer.write(sample(vec![0; 8])).is_ok() {
                if let Ok(received) = timeout(Duration::from_millis(40), reader.next()).await {
                    assert!(received.unwrap().sequence > SequenceNumber(5));
                    break;
                }
            }
        }
    };
    timeout(LONG, again).await.unwrap();
    assert_eq!(reader.counters().resynchronized, 1);
    assert_eq!(second.counters().unwrap().resynchronized, 1);
    let lines = warnings.with("began again");
    assert!(
        lines.len() == 1 && lines[0].contains("rt/x") && lines[0].contains(&writer.guid().to_string()),
        "{lines:?}"
    );
    assert_eq!(warnings.with("cannot be repaired").len(), 1);
}

#[tokio::test]
async fn malformed_datagrams_are_counted_and_logged_once() {
    let (warnings, _guard) = Warnings::begin();
    let domain = join(224).await;
    assert_eq!(domain.counters().unwrap().malformed, 0);
    for _ in 0..3 {
        inject(224, b"this is not RTPS, but long enough for a header");
    }
    until(|| domain.counters().unwrap().malformed == 3).await;
    assert_eq!(warnings.with("malformed").len(), 1);
}

#[tokio::test]
async fn a_writer_that_does_not_assert_itself_is_reported_as_not_alive_and_a_missed_deadline_is_counted() {
    let [first, second] = [join(223).await, join(223).await];
    let (mut writes, mut reads) = (endpoint(), endpoint());
    let micros = Ticks::from_micros(300_000);
    writes.qos =
        Qos { liveliness: LivelinessKind::ManualByTopic, liveliness_lease: micros, deadline: micros, ..writes.qos };
    reads.qos = writes.qos.clone();
    let writer = first.writer(writes).unwrap();
    let reader = second.reader(reads, LIMITS).unwrap();
    matched(reader.matches(), 1).await;
    matched(writer.matches(), 1).await;
    writer.write(sample(vec![0; 8])).unwrap();
    let mut matches = reader.matches().clone();
    timeout(LONG, matches.wait_for(|matches| matches.not_alive.contains(&writer.guid()))).await.unwrap().unwrap();
    until(|| reader.counters().deadlines_missed > 0).await;
    writer.assert_liveliness().unwrap();
    timeout(LONG, matches.wait_for(|matches| matches.not_alive.is_empty())).await.unwrap().unwrap();
    first.end();
    assert_eq!(writer.assert_liveliness(), Err(Ended));
}

#[tokio::test]
async fn samples_that_are_pushed_out_before_a_reader_has_them_are_counted_and_logged_once() {
    let (warnings, _guard) = Warnings::begin();
    let [first, second] = [join(222).await, join(222).await];
    let mut writes = endpoint();
    writes.qos.history = History::KeepAll;
    let writer = first.writer(writes).unwrap();
    let reader = second.reader(endpoint(), LIMITS).unwrap();
    matched(writer.matches(), 1).await;
    matched(reader.matches(), 1).await;
    assert_eq!(writer.losses(), WriterLosses::default());
    // Its process hangs: it acknowledges nothing, and says nothing.
    second.end();
    for _ in 0..4 {
        writer.write(sample(vec![0; SAMPLE_BYTES_MAX])).unwrap();
    }
    assert_eq!(writer.losses(), WriterLosses { replaced: 0, pushed_out: 3 });
    assert_eq!(warnings.with("pushed out").len(), 1);
}
