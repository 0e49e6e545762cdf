//! Receives samples.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant, SystemTime},
};

use iceoryx2::{
    identifiers::UniqueNodeId,
    port::{
        listener::{Listener, ListenerWaitError},
        notifier::Notifier,
        subscriber,
    },
    service::{ipc_threadsafe::Service, port_factory::PortFactory},
};
use ledger_gate::sample::Sample;

use super::{
    attempt::{blocking, failed, retry},
    header::{Header, decode_header},
    node::Node,
    peers::Peers,
    service::{BUFFER_SAMPLES, DataService},
};
use crate::{
    error::Result,
    graph::{
        endpoint::Role,
        loop_filter::{Entry, LoopFilter},
        names::TopicName,
        queue::{Incoming, Limits, Queue},
    },
    log::LogLimiter,
};

/// A subscriber looks for samples at least this often, also when a wake-up was lost.
const WAIT_MAX: Duration = Duration::from_secs(1);

impl Node {
    /// Starts to receive a topic; samples with this node's origin are left out.
    pub async fn subscriber(&self, topic: &TopicName, limits: Limits) -> Result<Subscriber> {
        self.subscribe(topic, limits, None).await
    }

    /// The same for samples that go to the ledger: only what the filter admits is given out.
    pub async fn subscriber_behind(
        &self,
        topic: &TopicName,
        limits: Limits,
        filter: Arc<LoopFilter>,
    ) -> Result<Subscriber> {
        self.subscribe(topic, limits, Some(filter)).await
    }

    async fn subscribe(
        &self,
        topic: &TopicName,
        limits: Limits,
        filter: Option<Arc<LoopFilter>>,
    ) -> Result<Subscriber> {
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
                filter,
                log_limiter: LogLimiter::default(),
            };
            let thread = std::thread::Builder::new().name("bridge-shm".to_owned());
            thread.spawn(move || pump.run()).map_err(|error| failed(&what, &error))?;
            Ok(Subscriber { queue, data: Arc::new(data), node: *node.node.id(), stop, waker })
        })
        .await
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

    /// The samples that wait.
    pub(crate) fn queue(&self) -> &Queue {
        &self.queue
    }
}

impl Drop for Subscriber {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        // Without the wake-up the thread sees the flag within WAIT_MAX.
        if let Err(error) = self.waker.notify() {
            tracing::debug!(%error, "cannot wake the shared memory thread");
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
    filter: Option<Arc<LoopFilter>>,
    log_limiter: LogLimiter,
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
                    tracing::error!(topic = %self.topic, %error, "subscription in shared memory ended");
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
                    if let Some(not_logged) = self.log_limiter.admit("unread", Instant::now()) {
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
                let judge = |filter: &Arc<LoopFilter>| filter.judge(source, mark, sample.wire(), received);
                if self.filter.as_ref().map_or(Entry::Admit, judge) == Entry::Admit {
                    self.queue.push(Incoming { sample, source, sequence, received, wall: SystemTime::now(), waited });
                }
            }
            Err(error) => {
                self.queue.count_dropped(1);
                let is_large = payload.len() > self.bytes_max;
                let why = if is_large { "larger than sample_bytes_max" } else { "no CDR" };
                if let Some(not_logged) = self.log_limiter.admit(why, Instant::now()) {
                    tracing::warn!(topic = %self.topic, %error, not_logged, "a sample from shared memory was dropped: {why}");
                }
            }
        }
    }
}
