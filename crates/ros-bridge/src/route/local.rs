//! The local side of routes: DDS, and shared memory beside it.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use ledger_gate::sample::Sample;

use crate::{
    dds::{Matched, Participant, Reader, Writer},
    door::{Delivered, Door},
    error::{Error, Result},
    mark::Mark,
    names::{TopicName, TypeName},
    qos::Qos,
    queue::{Incoming, Limits},
    reach::Reach,
    shm,
};

/// A stop message that a slow reader keeps from being written is tried so often.
const STOP_TRIES_MAX: u32 = 20;
/// How long each try waits for the reader.
const STOP_TRY: Duration = Duration::from_millis(50);

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
        let shm = match shared_memory {
            true => or_dds_only("any topic", shm::Node::open(domain, node_name, participant.guid()).await),
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

    pub(crate) async fn inlet(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        limits: Limits,
        door: Arc<Door>,
    ) -> Result<Inlet> {
        let reader = self.participant.reader_behind(topic, message, qos, limits, Arc::clone(&door))?;
        let shm = match &self.shm {
            Some(node) => or_dds_only(topic.as_str(), node.subscriber_behind(topic, limits, door).await),
            None => None,
        };
        Ok(Inlet { reader, shm })
    }

    pub(crate) async fn outlet(&self, topic: &TopicName, message: &TypeName, qos: &Qos, mark: Mark) -> Result<Outlet> {
        self.delivered.begins(mark);
        let writer = self.participant.marked_writer(topic, message, qos, mark)?;
        let shm = match &self.shm {
            Some(node) => or_dds_only(topic.as_str(), node.marked_publisher(topic, mark).await),
            None => None,
        };
        Ok(Outlet { writer, shm, mark, delivered: Arc::clone(&self.delivered) })
    }
}

/// Shared memory that cannot be used keeps nobody from DDS.
fn or_dds_only<T>(topic: &str, opened: Result<T>) -> Option<T> {
    let warn = |error: &Error| {
        tracing::warn!(topic, %error, "shared memory is not used for {topic}, only DDS, until this bridge starts again");
    };
    opened.inspect_err(warn).ok()
}

/// Where samples of a topic come in.
pub(crate) struct Inlet {
    reader: Reader,
    shm: Option<shm::Subscriber>,
}

impl Inlet {
    /// The next sample; none when the middleware ended. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Option<Incoming> {
        match &mut self.shm {
            None => self.reader.next().await,
            Some(shm) => tokio::select! {
                incoming = self.reader.next() => incoming,
                incoming = shm.next() => incoming,
            },
        }
    }

    /// The next sample if one waits.
    pub(crate) fn try_next(&mut self) -> Option<Incoming> {
        self.reader.try_next().or_else(|| self.shm.as_mut()?.try_next())
    }

    /// The publishers of others.
    pub(crate) fn matched(&self) -> &Matched {
        self.reader.matched()
    }

    /// Publishers in shared memory.
    pub(crate) fn in_memory(&self) -> Option<shm::Peers> {
        self.shm.as_ref().map(shm::Subscriber::peers)
    }

    /// Samples lost here: replaced by newer ones, too large, or not readable.
    pub(crate) fn dropped(&self) -> u64 {
        self.reader.dropped().saturating_add(self.shm.as_ref().map_or(0, shm::Subscriber::dropped))
    }
}

/// Where samples of a topic go out.
pub(crate) struct Outlet {
    writer: Writer,
    shm: Option<shm::Publisher>,
    mark: Mark,
    delivered: Arc<Delivered>,
}

impl Outlet {
    /// Publishes a sample, to local processes first: that is quicker. An error concerns one of both only.
    pub(crate) fn write(&self, sample: &Sample) -> Result<()> {
        self.note(sample);
        let shm = self.shm.as_ref().map_or(Ok(0), |shm| shm.write(sample));
        self.writer.write(sample)?;
        shm.map(drop)
    }

    /// Publishes a stop message; insists while a slow reader keeps it from being written.
    pub(crate) async fn write_stop(&self, stop: &Sample) -> Result<()> {
        self.note(stop);
        if let Some(Err(error)) = self.shm.as_ref().map(|shm| shm.write(stop)) {
            tracing::error!(%error, "the stop message did not reach shared memory");
        }
        for _ in 1..STOP_TRIES_MAX {
            match self.writer.write(stop) {
                Err(Error::Slow(_)) => self.writer.flush(STOP_TRY).await,
                done => return done,
            };
        }
        self.writer.write(stop)
    }

    /// Subscribers in shared memory.
    pub(crate) fn in_memory(&self) -> Option<shm::Peers> {
        self.shm.as_ref().map(shm::Publisher::peers)
    }

    /// Before it is written: an echo must not be quicker.
    fn note(&self, sample: &Sample) {
        self.delivered.note(self.mark, sample.wire(), Instant::now());
    }

    /// The subscribers of others.
    pub(crate) fn matched(&self) -> &Matched {
        self.writer.matched()
    }

    /// Waits until reliable readers have everything; false after `at_most`.
    pub(crate) async fn flush(&self, at_most: Duration) -> bool {
        self.writer.flush(at_most).await
    }
}
