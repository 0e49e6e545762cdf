//! The local side of routes: DDS, and shared memory beside it.

use std::{
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use ledger_gate::sample::Sample;
use tokio::sync::watch;

use super::calls::Hand;
use crate::{
    dds::{Matched, Participant, Reader, Writer},
    door::{Delivered, Door},
    error::{Error, Result},
    mark::Mark,
    names::{TopicName, TypeName},
    qos::{Durability, Qos},
    queue::{Incoming, Limits, Queue},
    reach::Reach,
    shm,
};

/// Opens a reader or writer with a quality of service.
type Open<T> = Box<dyn Fn(&Qos) -> Result<T> + Send + Sync>;

/// Our presence in the local graph: one participant and one origin for all routes, so that nothing a bridge
/// publishes is taken in by it again.
#[derive(Clone)]
pub(crate) struct Local {
    participant: Participant,
    shm: Option<shm::Node>,
    delivered: Arc<Delivered>,
}

impl Local {
    pub(crate) async fn open(domain: u16, reach: &Reach, node_name: &str, shared_memory: bool) -> Result<Self> {
        let participant = Participant::join(domain, node_name, reach).await?;
        let (origin, name) = (participant.guid(), shm::bridge_name(node_name, participant.guid()));
        let shm = match shared_memory {
            true => or_dds_only("any topic", shm::Node::open(domain, &name, origin).await),
            false => None,
        };
        Ok(Self { participant, shm, delivered: Arc::default() })
    }

    pub(crate) fn participant(&self) -> &Participant {
        &self.participant
    }

    /// The known deliveries of bridges to this graph.
    pub(crate) fn delivered(&self) -> &Arc<Delivered> {
        &self.delivered
    }

    /// Where samples of a topic come in; with its publishers over DDS, and in shared memory.
    pub(crate) async fn inlet(
        &self,
        topic: &TopicName,
        message: &TypeName,
        mut qos: watch::Receiver<Qos>,
        limits: Limits,
        door: Arc<Door>,
    ) -> Result<(Inlet, Matched, Option<shm::Peers>)> {
        let participant = self.participant.clone();
        let open = {
            let (participant, topic, message, door) =
                (participant.clone(), topic.clone(), message.clone(), Arc::clone(&door));
            move |qos: &Qos| participant.reader_behind(&topic, &message, qos, limits, Arc::clone(&door))
        };
        let first = *qos.borrow_and_update();
        let reader = open(&first)?;
        let shm = match &self.shm {
            Some(node) => or_dds_only(topic.as_str(), node.subscriber_behind(topic, limits, door).await),
            None => None,
        };
        let (matched, in_memory) = (reader.matched().clone(), shm.as_ref().map(shm::Subscriber::peers));
        let (topic, open, left) = (topic.clone(), Box::new(open), VecDeque::new());
        let topic = TopicInlet { topic, reader, left, open, qos, participant, lost: 0, shm };
        Ok((Inlet::Topic(Box::new(topic)), matched, in_memory))
    }

    pub(crate) async fn outlet(&self, topic: &TopicName, message: &TypeName, qos: &Qos, mark: Mark) -> Result<Outlet> {
        self.delivered.begins(mark);
        let open = {
            let (participant, topic, message) = (self.participant.clone(), topic.clone(), message.clone());
            move |qos: &Qos| participant.marked_writer(&topic, &message, qos, mark)
        };
        let writer = open(qos)?;
        let shm = match &self.shm {
            Some(node) => or_dds_only(topic.as_str(), node.marked_publisher(topic, mark).await),
            None => None,
        };
        let to = To::Topic { writer: Box::new(writer), open: Box::new(open), shm: shm.map(Box::new) };
        Ok(Outlet { to, mark, delivered: Arc::clone(&self.delivered) })
    }

    /// Where messages go to the other half of a route of calls.
    pub(crate) fn outlet_for_calls(&self, hand: Hand, mark: Mark) -> Outlet {
        Outlet { to: To::Calls(hand), mark, delivered: Arc::clone(&self.delivered) }
    }
}

/// Waits for another quality of service.
pub(super) fn changed(qos: &watch::Receiver<Qos>) -> impl Future<Output = ()> + use<> {
    let mut qos = qos.clone();
    async move {
        if qos.changed().await.is_err() {
            std::future::pending().await
        }
    }
}

/// Shared memory that cannot be used keeps nobody from DDS.
fn or_dds_only<T>(topic: &str, opened: Result<T>) -> Option<T> {
    let warn = |error: &Error| {
        tracing::warn!(topic, %error, "shared memory is not used for {topic}, only DDS, until this bridge starts again");
    };
    opened.inspect_err(warn).ok()
}

/// Where samples come in.
pub(crate) enum Inlet {
    /// From a topic.
    Topic(Box<TopicInlet>),
    /// From the other half of a route of calls.
    Calls(Arc<Queue>),
}

/// Where samples of a topic come in.
pub(crate) struct TopicInlet {
    topic: TopicName,
    reader: Reader,
    /// Samples that readers before this one have heard, and nobody has taken yet.
    left: VecDeque<Incoming>,
    /// Opens a reader in the place of the one before.
    open: Open<Reader>,
    /// The quality of service that it follows.
    qos: watch::Receiver<Qos>,
    participant: Participant,
    /// Samples that readers before this one have lost.
    lost: u64,
    /// None if it is not used, or has ended.
    shm: Option<shm::Subscriber>,
}

impl TopicInlet {
    async fn next(&mut self) -> Option<Incoming> {
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

    fn follow(&mut self) {
        let qos = *self.qos.borrow_and_update();
        match (self.open)(&qos) {
            Ok(reader) => {
                let mut before = std::mem::replace(&mut self.reader, reader);
                self.left.extend(std::iter::from_fn(|| before.try_next()));
                self.lost = self.lost.saturating_add(before.dropped());
            }
            Err(error) => tracing::warn!(%error, "the topic is read as before"),
        }
    }

    fn try_next(&mut self) -> Option<Incoming> {
        let next = self.left.pop_front().or_else(|| self.reader.try_next());
        next.or_else(|| self.shm.as_mut()?.try_next())
    }

    fn dropped(&self) -> u64 {
        let lost = self.lost.saturating_add(self.reader.dropped());
        lost.saturating_add(self.shm.as_ref().map_or(0, shm::Subscriber::dropped))
    }
}

impl Inlet {
    /// The next sample; none when the middleware ended. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Option<Incoming> {
        match self {
            Self::Topic(topic) => topic.next().await,
            Self::Calls(queue) => queue.next().await,
        }
    }

    /// The next sample if one waits.
    pub(crate) fn try_next(&mut self) -> Option<Incoming> {
        match self {
            Self::Topic(topic) => topic.try_next(),
            Self::Calls(queue) => queue.try_next(),
        }
    }

    /// Do its publishers keep what they said for those who come late?
    pub(crate) fn is_latched(&self) -> bool {
        matches!(self, Self::Topic(topic) if topic.qos.borrow().durability == Durability::TransientLocal)
    }

    /// Is this publisher still in the graph?
    pub(crate) fn has_publisher(&self, source: &[u8; 16]) -> bool {
        matches!(self, Self::Topic(topic) if topic.participant.has_publisher(source))
    }

    /// Waits until others on the topic need another quality of service: see [`Inlet::follow`].
    pub(crate) fn to_follow(&self) -> impl Future<Output = ()> + use<> {
        let waits = match self {
            Self::Topic(topic) => Some(changed(&topic.qos)),
            Self::Calls(_) => None,
        };
        async move {
            match waits {
                Some(waits) => waits.await,
                None => std::future::pending().await,
            }
        }
    }

    /// Reads with the quality of service that meets the others; answers who they are now. Samples that the reader before has heard
    /// come first.
    pub(crate) fn follow(&mut self) -> Option<Matched> {
        let Self::Topic(topic) = self else { return None };
        topic.follow();
        Some(topic.reader.matched().clone())
    }

    /// Samples lost here: replaced by newer ones, too large, or not readable.
    pub(crate) fn dropped(&self) -> u64 {
        match self {
            Self::Topic(topic) => topic.dropped(),
            Self::Calls(queue) => queue.dropped(),
        }
    }

    /// Loses shared memory as a fault would take it away.
    #[cfg(test)]
    pub(crate) fn break_down_shared_memory(&self) {
        let Self::Topic(topic) = self else { return };
        topic.shm.iter().for_each(shm::Subscriber::break_down);
    }
}

/// Where samples go out.
pub(crate) struct Outlet {
    to: To,
    mark: Mark,
    delivered: Arc<Delivered>,
}

/// The ways out.
enum To {
    /// To a topic. `open` opens a writer in the place of the one before.
    Topic { writer: Box<Writer>, open: Open<Writer>, shm: Option<Box<shm::Publisher>> },
    /// To the other half of a route of calls.
    Calls(Hand),
}

impl Outlet {
    /// Offers the topic with another quality of service.
    pub(crate) fn follow(&mut self, qos: &Qos) {
        let To::Topic { writer, open, .. } = &mut self.to else { return };
        match open(qos) {
            Ok(opened) => **writer = opened,
            Err(error) => tracing::warn!(%error, "the topic is offered as before"),
        }
    }

    /// How many listen, over DDS and in shared memory.
    pub(crate) fn listeners(&self) -> usize {
        self.matched().now().matched + self.in_memory().map_or(0, |peers| peers.count())
    }

    /// Publishes a sample, to local processes first: that is quicker. An error concerns one of both only.
    pub(crate) fn write(&self, sample: &Sample) -> Result<()> {
        let To::Topic { writer, shm, .. } = &self.to else { return Ok(()) };
        self.note(sample);
        let shm = shm.as_ref().map_or(Ok(0), |shm| shm.write(sample));
        writer.write(sample)?;
        shm.map(drop)
    }

    /// The other half of a route of calls: it takes whole messages.
    pub(crate) fn hand(&mut self) -> Option<&mut Hand> {
        match &mut self.to {
            To::Calls(hand) => Some(hand),
            To::Topic { .. } => None,
        }
    }

    /// Subscribers in shared memory.
    pub(crate) fn in_memory(&self) -> Option<shm::Peers> {
        match &self.to {
            To::Topic { shm, .. } => shm.as_ref().map(|shm| shm.peers()),
            To::Calls(_) => None,
        }
    }

    /// Before it is written: an echo must not be quicker.
    fn note(&self, sample: &Sample) {
        self.delivered.note(self.mark, sample.wire(), Instant::now());
    }

    /// The subscribers of others.
    pub(crate) fn matched(&self) -> &Matched {
        match &self.to {
            To::Topic { writer, .. } => writer.matched(),
            To::Calls(hand) => hand.matched(),
        }
    }

    /// Waits until reliable readers have everything; false after `at_most`.
    pub(crate) async fn flush(&self, at_most: Duration) -> bool {
        match &self.to {
            To::Topic { writer, .. } => writer.flush(at_most).await,
            To::Calls(_) => true,
        }
    }
}
