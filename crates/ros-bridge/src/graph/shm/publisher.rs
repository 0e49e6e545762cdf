//! Publishes samples.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use iceoryx2::{
    identifiers::UniqueNodeId,
    port::{backpressure_strategy::BackpressureStrategy, notifier::Notifier, publisher},
    prelude::AllocationStrategy,
    service::{ipc_threadsafe::Service, port_factory::PortFactory},
};
use ledger_gate::sample::Sample;

use super::{
    attempt::{blocking, failed, retry},
    header::{Header, encode_header},
    node::Node,
    peers::Peers,
    service::DataService,
};
use crate::{
    error::Result,
    graph::{endpoint::Role, mark::Mark, names::TopicName},
};

/// Samples for which a publisher sets memory aside; the memory grows with the largest sample sent.
const PREALLOCATED_SAMPLES_MAX: usize = 64;
/// Largest sample in bytes without growing.
const FIRST_SLICE_BYTES: usize = 4096;

impl Node {
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
            tracing::debug!(topic = %self.topic, %error, "cannot wake a subscriber in shared memory");
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
