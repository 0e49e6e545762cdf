//! The samples of a topic, from both transports.

use std::collections::VecDeque;

use tokio::sync::watch;

use crate::{
    error::Result,
    graph::{
        dds::{Matched, Participant, Reader},
        names::TopicName,
        qos::{Durability, Qos},
        queue::Incoming,
        shm,
    },
};

/// Opens a reader with a quality of service.
type Open = Box<dyn Fn(&Qos) -> Result<Reader> + Send + Sync>;

/// Where samples of a topic come in.
pub(crate) struct TopicInput {
    topic: TopicName,
    reader: Reader,
    /// Samples that readers before this one have received, and that were not taken yet.
    left: VecDeque<Incoming>,
    /// Opens a reader in the place of the one before.
    open: Open,
    /// The quality of service that it follows.
    qos: watch::Receiver<Qos>,
    participant: Participant,
    /// Samples that readers before this one have lost.
    lost: u64,
    /// None if it is not used, or has ended.
    shm: Option<shm::Subscriber>,
}

impl TopicInput {
    pub(super) fn open(
        topic: TopicName,
        open: Open,
        mut qos: watch::Receiver<Qos>,
        participant: Participant,
    ) -> Result<Self> {
        let first = *qos.borrow_and_update();
        let reader = open(&first)?;
        Ok(Self { topic, reader, left: VecDeque::new(), open, qos, participant, lost: 0, shm: None })
    }

    /// Reads from shared memory too.
    pub(super) fn add(&mut self, shm: Option<shm::Subscriber>) {
        self.shm = shm;
    }

    /// The next sample; none when the middleware ended. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Option<Incoming> {
        if let Some(left) = self.left.pop_front() {
            return Some(left);
        }
        if let Some(shm) = &mut self.shm {
            tokio::select! {
                incoming = self.reader.next() => return incoming,
                incoming = shm.next() => if incoming.is_some() {
                    return incoming;
                },
            }
            let topic = self.topic.as_str();
            tracing::warn!(
                topic,
                "shared memory is not used for {topic} any more, only DDS, until this bridge starts again"
            );
            self.lost = self.lost.saturating_add(shm.dropped());
            self.shm = None;
        }
        self.reader.next().await
    }

    /// The next sample if one waits.
    pub(crate) fn try_next(&mut self) -> Option<Incoming> {
        let next = self.left.pop_front().or_else(|| self.reader.try_next());
        next.or_else(|| self.shm.as_mut()?.try_next())
    }

    /// Do its publishers keep their last samples for late subscribers?
    pub(crate) fn is_latched(&self) -> bool {
        self.qos.borrow().durability == Durability::TransientLocal
    }

    /// Is this publisher still in the graph?
    pub(crate) fn has_publisher(&self, source: &[u8; 16]) -> bool {
        self.participant.has_publisher(source)
    }

    /// The quality of service that it follows.
    pub(crate) fn qos(&self) -> &watch::Receiver<Qos> {
        &self.qos
    }

    /// Reads with the quality of service that meets the others. Samples that the reader before has received come first.
    pub(crate) fn follow(&mut self) {
        let qos = *self.qos.borrow_and_update();
        match (self.open)(&qos) {
            Ok(reader) => {
                let mut before = std::mem::replace(&mut self.reader, reader);
                self.left.extend(std::iter::from_fn(|| before.try_next()));
                self.lost = self.lost.saturating_add(before.dropped());
            }
            Err(error) => tracing::warn!(%error, "cannot change the subscription; the topic is read as before"),
        }
    }

    /// The publishers of others over DDS.
    pub(crate) fn matched(&self) -> &Matched {
        self.reader.matched()
    }

    /// The publishers in shared memory.
    pub(crate) fn in_memory(&self) -> Option<shm::Peers> {
        self.shm.as_ref().map(shm::Subscriber::peers)
    }

    /// Samples lost here: replaced by newer ones, too large, or not readable.
    pub(crate) fn dropped(&self) -> u64 {
        let lost = self.lost.saturating_add(self.reader.dropped());
        lost.saturating_add(self.shm.as_ref().map_or(0, shm::Subscriber::dropped))
    }

    /// Loses shared memory as a fault would take it away.
    #[cfg(test)]
    pub(crate) fn break_down_shared_memory(&self) {
        self.shm.iter().for_each(shm::Subscriber::break_down);
    }
}
