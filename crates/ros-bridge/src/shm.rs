//! The shared memory side: raw samples between processes of one machine, over iceoryx2.
//!
//! # Contract with local processes
//! - **Service**: publish-subscribe of `[u8]`, named like the DDS topic: `rt/cmd_vel` in domain 0 and `domainN/rt/…` in
//!   domain N. Shared memory has no domains, and two graphs on one machine must not meet behind the ledger's back. The
//!   payload is the sample with its encapsulation header, byte for byte what DDS carries ([`Sample::wire`]).
//! - **User header**: 32 bytes, `[u8; 32]`, so that no padding and no byte order is left to the compiler. They are
//!   `origin` (16, the publisher), `sequence` (8, little endian, counts from 1) and `mark` (8, little endian). A
//!   process that publishes by itself takes any origin that is unique, best random; zero is allowed and stands for
//!   "unknown". Its mark is zero: others are set by bridges on what came from the ledger ([`Mark::nanos`]).
//! - **Name of the node**: any; that of a bridge ends with `@` and its origin, so that bridges of one service know each
//!   other. Everybody else who publishes where a bridge delivers commands is reported as a side door.
//! - **Event service** of the same name: notify it after each publication, wait on it for news.
//! - A bridge drops what carries its own origin, or the mark of its network, so nothing goes in circles.
//! - All processes run as the same user. The first one to open a service sets its limits; ours are [`PUBLISHERS_MAX`],
//!   [`SUBSCRIBERS_MAX`], [`BUFFER_SAMPLES`]. A bridge takes a service as others have opened it, with any limits. It
//!   needs room for one publisher, subscriber, notifier or listener of its own.
//!
//! The remains of a killed process are removed when the next node starts or opens a service. Two processes that do so
//! at the same time can disturb each other, so opening is tried several times.
//!
//! iceoryx2 would take over SIGINT and SIGTERM; that is switched off. Arrays of bytes are sendable without any
//! `unsafe`, which is the other reason for the plain header.

mod peers;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant, SystemTime},
};

use iceoryx2::{
    identifiers::UniqueNodeId,
    node::{Node as IoxNode, NodeBuilder, NodeCreationFailure},
    port::backpressure_strategy::BackpressureStrategy,
    port::{
        listener::{Listener, ListenerWaitError},
        notifier::Notifier,
        publisher, subscriber,
    },
    prelude::{AllocationStrategy, LogLevel, NodeName, ServiceName, SignalHandlingMode, set_log_level_from_env_or},
    service::{
        builder::{
            event::{EventOpenError, EventOpenOrCreateError},
            publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError},
        },
        ipc_threadsafe::Service,
        port_factory::{self, PortFactory},
    },
};
use ledger_gate::sample::Sample;

pub(crate) use self::peers::{Peers, Publisher as OtherPublisher, bridge_name};
use crate::{
    count::Complaint,
    dds::Role,
    door::{Door, Entry},
    error::{Error, Explained, Result},
    mark::Mark,
    names::TopicName,
    queue::{Incoming, Limits, Queue},
};

/// Most publishers of a service.
pub const PUBLISHERS_MAX: usize = 16;
/// Most subscribers of a service.
pub const SUBSCRIBERS_MAX: usize = 16;
/// Most processes that use a service.
const NODES_MAX: usize = 32;
/// Samples that wait for each subscriber; a slow one loses the oldest.
pub const BUFFER_SAMPLES: usize = 32;
/// Samples for which a publisher sets memory aside; the memory grows with the largest sample sent.
const PREALLOCATED_SAMPLES_MAX: usize = 64;
/// Largest sample in bytes without growing.
const FIRST_SLICE_BYTES: usize = 4096;
/// Tries to open something that others create or clean up at the same time.
const OPEN_TRIES_MAX: u32 = 20;
const OPEN_PAUSE: Duration = Duration::from_millis(50);
/// A subscriber looks for samples at least this often, also when a wake-up was lost.
const WAIT_MAX: Duration = Duration::from_secs(1);

const HEADER_BYTES: usize = 32;
type Header = [u8; HEADER_BYTES];
type DataService = port_factory::publish_subscribe::PortFactory<Service, [u8], Header>;
type EventService = port_factory::event::PortFactory<Service>;

/// Our presence in the shared memory of this machine. Cloning shares it.
#[derive(Clone)]
pub struct Node {
    node: Arc<IoxNode<Service>>,
    domain: u16,
    origin: [u8; 16],
}

impl Node {
    /// Opens the shared memory of a ROS domain under a name that tools show. `origin` marks what we publish: unique in
    /// the world, such as the GUID of a DDS participant.
    pub async fn open(domain: u16, name: &str, origin: [u8; 16]) -> Result<Self> {
        let node_name = NodeName::new(name).map_err(|error| failed(&format!("node name {name:?}"), &error))?;
        blocking(move || {
            set_log_level_from_env_or(LogLevel::Error);
            let create = || -> std::result::Result<_, NodeCreationFailure> {
                let builder = NodeBuilder::new().name(&node_name);
                builder.signal_handling_mode(SignalHandlingMode::Disabled).create::<Service>()
            };
            Ok(Self { node: Arc::new(retry("cannot open shared memory", create)?), domain, origin })
        })
        .await
    }

    /// Starts to publish a topic.
    pub async fn publisher(&self, topic: &TopicName) -> Result<Publisher> {
        self.publish(topic, None).await
    }

    /// Starts to publish samples of a topic that come from the ledger. No bridge of that network takes them in.
    pub async fn marked_publisher(&self, topic: &TopicName, mark: Mark) -> Result<Publisher> {
        self.publish(topic, Some(mark)).await
    }

    async fn publish(&self, topic: &TopicName, mark: Option<Mark>) -> Result<Publisher> {
        let (node, topic) = (self.clone(), topic.clone());
        blocking(move || {
            let (data, events) = node.services(&topic)?;
            let what = format!("cannot publish {topic} in shared memory");
            let port = retry(&what, || {
                data.publisher_builder()
                    .initial_max_slice_len(FIRST_SLICE_BYTES)
                    .allocation_strategy(AllocationStrategy::PowerOfTwo)
                    // Where the service overwrites nothing, a subscriber that is full gets less; nobody waits for it.
                    .backpressure_strategy(BackpressureStrategy::DiscardData)
                    .override_sample_preallocation(|worst| worst.min(PREALLOCATED_SAMPLES_MAX))
                    .create()
            })?;
            let notifier = retry(&what, || events.notifier_builder().create())?;
            Ok(Publisher {
                port,
                notifier,
                data: Arc::new(data),
                node: *node.node.id(),
                origin: node.origin,
                mark,
                sequence: AtomicU64::new(0),
                topic,
            })
        })
        .await
    }

    /// Starts to receive a topic; samples with this node's origin are left out.
    pub async fn subscriber(&self, topic: &TopicName, limits: Limits) -> Result<Subscriber> {
        self.subscribe(topic, limits, None).await
    }

    /// The same for samples that go to the ledger: only what the door admits is given out.
    pub async fn subscriber_behind(&self, topic: &TopicName, limits: Limits, door: Arc<Door>) -> Result<Subscriber> {
        self.subscribe(topic, limits, Some(door)).await
    }

    async fn subscribe(&self, topic: &TopicName, limits: Limits, door: Option<Arc<Door>>) -> Result<Subscriber> {
        let (node, topic) = (self.clone(), topic.clone());
        blocking(move || {
            let (data, events) = node.services(&topic)?;
            let what = format!("cannot subscribe {topic} in shared memory");
            let listener = retry(&what, || events.listener_builder().create())?;
            let waker = retry(&what, || events.notifier_builder().create())?;
            let buffer = BUFFER_SAMPLES.min(data.static_config().subscriber_max_buffer_size());
            let port = retry(&what, || data.subscriber_builder().buffer_size(buffer).create())?;
            let queue = Queue::new(&limits);
            let stop = Arc::new(AtomicBool::new(false));
            let pump = Pump {
                port,
                listener,
                queue: Arc::clone(&queue),
                stop: Arc::clone(&stop),
                origin: node.origin,
                bytes_max: limits.sample_bytes_max,
                topic: topic.clone(),
                door,
                complaint: Complaint::default(),
            };
            let thread = std::thread::Builder::new().name("bridge-shm".to_owned());
            thread.spawn(move || pump.run()).map_err(|error| failed(&what, &error))?;
            Ok(Subscriber { queue, data: Arc::new(data), node: *node.node.id(), stop, waker })
        })
        .await
    }

    fn services(&self, topic: &TopicName) -> Result<(DataService, EventService)> {
        let what = format!("cannot open {topic} in shared memory");
        let name = match self.domain {
            0 => topic.dds(),
            domain => format!("domain{domain}/{}", topic.dds()),
        };
        let name = ServiceName::new(&name).map_err(|error| failed(&what, &error))?;
        let data = retry(&what, || self.data_service(&name))?;
        let events = retry(&what, || self.event_service(&name))?;
        Ok((data, events))
    }

    /// The samples: as another process has opened the service, else with our limits.
    fn data_service(&self, name: &ServiceName) -> std::result::Result<DataService, PublishSubscribeOpenOrCreateError> {
        let builder = || self.node.service_builder(name).publish_subscribe::<[u8]>().user_header::<Header>();
        match builder().open() {
            Err(PublishSubscribeOpenError::DoesNotExist) => Ok(builder()
                .max_publishers(PUBLISHERS_MAX)
                .max_subscribers(SUBSCRIBERS_MAX)
                .max_nodes(NODES_MAX)
                .subscriber_max_buffer_size(BUFFER_SAMPLES)
                .enable_safe_overflow(true)
                .create()?),
            opened => Ok(opened?),
        }
    }

    /// The wake-ups, in the same way.
    fn event_service(&self, name: &ServiceName) -> std::result::Result<EventService, EventOpenOrCreateError> {
        match self.node.service_builder(name).event().open() {
            Err(EventOpenError::DoesNotExist) => Ok(self
                .node
                .service_builder(name)
                .event()
                .max_notifiers(PUBLISHERS_MAX + SUBSCRIBERS_MAX)
                .max_listeners(SUBSCRIBERS_MAX)
                .max_nodes(NODES_MAX)
                .create()?),
            opened => Ok(opened?),
        }
    }
}

/// Publishes raw samples of one topic.
pub struct Publisher {
    port: publisher::Publisher<Service, [u8], Header>,
    notifier: Notifier<Service>,
    data: Arc<DataService>,
    node: UniqueNodeId,
    origin: [u8; 16],
    mark: Option<Mark>,
    sequence: AtomicU64,
    topic: TopicName,
}

impl Publisher {
    /// Copies a sample into shared memory and wakes the subscribers; never waits. Returns how many it reached.
    pub fn write(&self, sample: &Sample) -> Result<usize> {
        let what = || format!("cannot publish on {} in shared memory", self.topic);
        let wire = sample.wire();
        let mut loan = self.port.loan_slice_uninit(wire.len()).map_err(|error| failed(&what(), &error))?;
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed).saturating_add(1);
        *loan.user_header_mut() = encode_header(self.origin, sequence, self.mark);
        let reached = loan.write_from_slice(wire).send().map_err(|error| failed(&what(), &error))?;
        if let Err(error) = self.notifier.notify() {
            tracing::debug!(topic = %self.topic, %error, "a subscriber in shared memory was not woken");
        }
        Ok(reached)
    }

    /// Subscribers of the topic in shared memory, ours included.
    pub fn subscribers(&self) -> usize {
        self.data.dynamic_config().number_of_subscribers()
    }

    /// The subscribers, to count them later.
    pub(crate) fn peers(&self) -> Peers {
        Peers { data: Arc::clone(&self.data), role: Role::Subscriber, own: self.node }
    }
}

/// Receives raw samples of one topic; ends when dropped. A thread moves them into a queue limited in bytes.
pub struct Subscriber {
    queue: Arc<Queue>,
    data: Arc<DataService>,
    node: UniqueNodeId,
    stop: Arc<AtomicBool>,
    waker: Notifier<Service>,
}

impl Subscriber {
    /// The next sample, as soon as there is one. Cancelling it loses nothing.
    pub async fn next(&mut self) -> Option<Incoming> {
        self.queue.next().await
    }

    /// The next sample if one waits.
    pub fn try_next(&mut self) -> Option<Incoming> {
        self.queue.try_next()
    }

    /// Publishers of the topic in shared memory, ours included.
    pub fn publishers(&self) -> usize {
        self.data.dynamic_config().number_of_publishers()
    }

    /// The publishers, to count them later.
    pub(crate) fn peers(&self) -> Peers {
        Peers { data: Arc::clone(&self.data), role: Role::Publisher, own: self.node }
    }

    /// Samples dropped so far: not valid, too large, or pushed out of a full queue.
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }

    /// Ends as a fault would end it.
    #[cfg(test)]
    pub(crate) fn break_down(&self) {
        self.queue.close();
    }
}

impl Drop for Subscriber {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        // Without the wake-up the thread sees the flag within WAIT_MAX.
        if let Err(error) = self.waker.notify() {
            tracing::debug!(%error, "the thread of shared memory was not woken");
        }
    }
}

/// The state of the thread behind a subscriber.
struct Pump {
    port: subscriber::Subscriber<Service, [u8], Header>,
    listener: Listener<Service>,
    queue: Arc<Queue>,
    stop: Arc<AtomicBool>,
    origin: [u8; 16],
    bytes_max: usize,
    topic: TopicName,
    door: Option<Arc<Door>>,
    complaint: Complaint,
}

impl Pump {
    fn run(mut self) {
        let mut waited = Duration::ZERO;
        while !self.stop.load(Ordering::Acquire) {
            self.drain(waited);
            let since = Instant::now();
            waited = match self.listener.timed_wait(|_| (), WAIT_MAX) {
                Ok(_) => Duration::ZERO,
                // This process stood still (SIGSTOP), and goes on. What lies there now may have come at the beginning of that.
                Err(ListenerWaitError::InterruptSignal) => since.elapsed(),
                Err(error) => {
                    tracing::error!(topic = %self.topic, %error, "the subscription in shared memory has ended");
                    break;
                }
            };
        }
        self.queue.close();
    }

    /// Takes all samples that lie there, since so long as far as anybody knows.
    fn drain(&mut self, waited: Duration) {
        loop {
            match self.port.receive() {
                Ok(Some(sample)) => self.take(sample.user_header(), sample.payload(), waited),
                Ok(None) => return,
                Err(error) => {
                    if let Some(not_logged) = self.complaint.worth("unread", Instant::now()) {
                        tracing::warn!(topic = %self.topic, %error, not_logged, "cannot read shared memory now");
                    }
                    return;
                }
            }
        }
    }

    fn take(&mut self, header: &Header, payload: &[u8], waited: Duration) {
        let (source, sequence, mark) = decode_header(header);
        if source == self.origin {
            return;
        }
        match Sample::copy_from_wire(payload, self.bytes_max) {
            Ok(sample) => {
                let received = Instant::now();
                let judge = |door: &Arc<Door>| door.judge(source, mark, sample.wire(), received);
                if self.door.as_ref().map_or(Entry::Admit, judge) == Entry::Admit {
                    self.queue.push(Incoming { sample, source, sequence, received, wall: SystemTime::now(), waited });
                }
            }
            Err(error) => {
                self.queue.count_dropped();
                let is_large = payload.len() > self.bytes_max;
                let why = if is_large { "larger than sample_bytes_max" } else { "no CDR" };
                if let Some(not_logged) = self.complaint.worth(why, Instant::now()) {
                    tracing::warn!(topic = %self.topic, %error, not_logged, "a sample from shared memory was dropped: {why}");
                }
            }
        }
    }
}

fn encode_header(origin: [u8; 16], sequence: u64, mark: Option<Mark>) -> Header {
    let mut header = [0; HEADER_BYTES];
    let mark = mark.map_or(0, Mark::nanos);
    let bytes = origin.into_iter().chain(sequence.to_le_bytes()).chain(mark.to_le_bytes());
    header.iter_mut().zip(bytes).for_each(|(to, from)| *to = from);
    header
}

fn decode_header(header: &Header) -> ([u8; 16], u64, Option<Mark>) {
    let origin = header.first_chunk().copied().unwrap_or_default();
    let number = |at: usize| {
        let bytes = header.get(at..).and_then(|rest| rest.first_chunk()).copied();
        bytes.map_or(0, u64::from_le_bytes)
    };
    (origin, number(16), Mark::from_nanos(number(24)))
}

/// Tries again what fails while others create or clean up the same thing.
fn retry<T, E: std::fmt::Debug + std::fmt::Display>(
    what: &str,
    mut attempt: impl FnMut() -> std::result::Result<T, E>,
) -> Result<T> {
    let mut tries = 1;
    loop {
        match attempt() {
            Ok(done) => return Ok(done),
            Err(error) if tries >= OPEN_TRIES_MAX => return Err(failed(what, &error)),
            Err(error) => {
                tracing::debug!(what, %error, tries, "trying again");
                tries += 1;
                std::thread::sleep(OPEN_PAUSE);
            }
        }
    }
}

fn failed(what: &str, error: &dyn std::fmt::Debug) -> Error {
    let wanted = "free, compatible shared memory of this user in /dev/shm and /tmp/iceoryx2";
    let hint = "run all processes as one user, with the types that docs/bridge.md names; if it stays, stop them and delete /tmp/iceoryx2";
    Error::Shm(Explained::new(what, format!("{error:?}"), wanted, hint))
}

/// Runs what may wait (files, locks, retries) off the threads of the runtime.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| failed("shared memory task ended early", &error))?
}
