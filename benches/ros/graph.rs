//! The two ends: a ROS 2 node that publishes at a fixed rate, and one that notes when what arrives.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::load::{histogram, wait_until};
use hdrhistogram::Histogram;
use ledger_gate::sample::{CDR_LE, Sample};
use ros_bridge::dds::{Participant, Reader, Writer};
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::{Incoming, Limits};
use ros_bridge::shm;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// Time for both ends to be connected.
const CONNECT_MAX: Duration = Duration::from_secs(30);
/// So long after the last sample was due it is waited for.
const LATE_MAX: Duration = Duration::from_secs(5);

/// The middleware that carries samples at both ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Middleware {
    /// DDS over UDP on the loopback.
    Dds,
    /// iceoryx2.
    SharedMemory,
}

impl Middleware {
    /// As it is called in results.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Dds => "dds",
            Self::SharedMemory => "shared_memory",
        }
    }
}

enum Publisher {
    Dds(Box<Writer>),
    SharedMemory(Box<shm::Publisher>),
}

enum Subscriber {
    Dds(Reader),
    SharedMemory(Box<shm::Subscriber>),
}

/// A publisher and a subscriber of `/cmd_vel`.
pub(crate) struct Ends {
    publisher: Publisher,
    /// When samples arrived, by number.
    arrived: Arc<Mutex<HashMap<u64, Instant>>>,
    next: u64,
    listening: JoinHandle<()>,
}

impl Drop for Ends {
    fn drop(&mut self) {
        self.listening.abort();
    }
}

impl Ends {
    /// Joins two domains, which may be the same, and waits until somebody is on the other side of each end.
    pub(crate) async fn open(middleware: Middleware, from: u16, to: u16) -> Self {
        let (topic, message) =
            (TopicName::parse("/cmd_vel").unwrap(), TypeName::parse("geometry_msgs/msg/Twist").unwrap());
        let (publisher, subscriber) = match middleware {
            Middleware::Dds => {
                let here = Participant::open(from, "operator").await.unwrap();
                let there = Participant::open(to, "robot").await.unwrap();
                let writer = here.writer(&topic, &message, &Qos::default()).unwrap();
                let reader = there.reader(&topic, &message, &Qos::default(), Limits::default()).unwrap();
                let both = async { writer.matched().at_least(1).await && reader.matched().at_least(1).await };
                assert!(timeout(CONNECT_MAX, both).await.expect("nobody was discovered"));
                (Publisher::Dds(writer.into()), Subscriber::Dds(reader))
            }
            Middleware::SharedMemory => {
                let here = shm::Node::open(from, "operator", [1; 16]).await.unwrap();
                let there = shm::Node::open(to, "robot", [2; 16]).await.unwrap();
                let publisher = here.publisher(&topic).await.unwrap();
                let subscriber = there.subscriber(&topic, Limits::default()).await.unwrap();
                let deadline = Instant::now() + CONNECT_MAX;
                while publisher.subscribers() == 0 || subscriber.publishers() == 0 {
                    assert!(Instant::now() < deadline, "nobody is in shared memory");
                    tokio::time::sleep(Duration::from_millis(10)).await;
                }
                (Publisher::SharedMemory(publisher.into()), Subscriber::SharedMemory(subscriber.into()))
            }
        };
        let arrived = Arc::default();
        let listening = tokio::spawn(listen(subscriber, Arc::clone(&arrived)));
        Self { publisher, arrived, next: 1, listening }
    }

    /// Publishes one sample.
    pub(crate) fn write(&mut self, runtime: &Runtime) {
        let _context = runtime.enter();
        let sample = Sample::new(CDR_LE, &twist(self.next)).unwrap();
        self.next += 1;
        self.publish(&sample);
    }

    fn publish(&self, sample: &Sample) {
        match &self.publisher {
            Publisher::Dds(writer) => writer.write(sample).unwrap(),
            Publisher::SharedMemory(publisher) => drop(publisher.write(sample).unwrap()),
        }
    }

    /// How many samples arrived that no run has counted, and when the last one did.
    pub(crate) fn arrivals(&self) -> (usize, Instant) {
        let arrived = self.arrived.lock().unwrap();
        (arrived.len(), arrived.values().max().copied().unwrap_or_else(Instant::now))
    }

    /// Publishes at `hz` for `duration`; answers with the time from when each sample was due until it arrived, and how
    /// many did not arrive.
    pub(crate) fn run(&mut self, runtime: &Runtime, hz: f64, duration: Duration) -> (Histogram<u64>, usize) {
        let _context = runtime.enter();
        let count = (duration.as_secs_f64() * hz).ceil().max(2.0) as u32;
        let first = self.next;
        self.next += u64::from(count);
        let start = Instant::now() + Duration::from_millis(10);
        let due = |number: u32| start + Duration::from_secs_f64(f64::from(number) / hz);
        for number in 0..count {
            let sample = Sample::new(CDR_LE, &twist(first + u64::from(number))).unwrap();
            wait_until(due(number));
            self.publish(&sample);
        }
        let deadline = Instant::now() + LATE_MAX;
        while self.arrived.lock().unwrap().len() < count as usize && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
        let arrived = std::mem::take(&mut *self.arrived.lock().unwrap());
        let latencies: Vec<_> =
            (0..count).filter_map(|number| Some(*arrived.get(&(first + u64::from(number)))? - due(number))).collect();
        let lost = count as usize - latencies.len();
        (histogram(latencies.into_iter()), lost)
    }
}

async fn listen(mut subscriber: Subscriber, arrived: Arc<Mutex<HashMap<u64, Instant>>>) {
    loop {
        let incoming = match &mut subscriber {
            Subscriber::Dds(reader) => reader.next().await,
            Subscriber::SharedMemory(subscriber) => subscriber.next().await,
        };
        // A user's callback runs now, not when the middleware had it.
        let now = Instant::now();
        let Some(Incoming { sample, .. }) = incoming else { return };
        let number = (f64::from_le_bytes(sample.body()[..8].try_into().unwrap()) * NUMBERS) as u64;
        // A stop message has the number 0.
        if number > 0 {
            arrived.lock().unwrap().entry(number).or_insert(now);
        }
    }
}

/// Numbers are divided by this: no speed is above 10 000.
const NUMBERS: f64 = 1024.0;

/// A Twist whose first value is a number.
fn twist(number: u64) -> Vec<u8> {
    [number as f64 / NUMBERS, 0.0, 0.0, 0.0, 0.0, 0.25].into_iter().flat_map(f64::to_le_bytes).collect()
}
