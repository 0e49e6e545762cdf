//! Receives raw messages of a topic.

use bytes::Bytes;
use zenoh::{
    Wait,
    bytes::ZBytes,
    pubsub::Subscriber as Plain,
    sample::{Locality, Sample, SampleKind},
};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig, RecoveryConfig};

use crate::{
    attachment::{ATTACHMENT_BYTES, Attachment},
    endpoint::Announced,
    error::{Error, failed},
    gid::Gid,
    key::Subject,
    node::Node,
    qos::TokenQos,
    token::Kind,
};

/// Most bytes of an attachment that are looked at: later versions may put more behind what is known.
const ATTACHMENT_BYTES_MAX: usize = 4 * ATTACHMENT_BYTES;

/// An arrival on a topic.
#[derive(Debug)]
pub enum Incoming {
    /// A message: CDR with its encapsulation header.
    Message(Bytes, Attachment),
    /// A message that is too long, of that many bytes. It was not copied.
    TooLong(usize),
    /// A message whose attachment is missing or malformed: no ROS 2 node has sent it.
    Malformed,
}

/// Subscribes to one topic; leaves the graph when dropped.
pub struct Subscriber {
    _input: Input,
    announced: Announced,
}

#[expect(dead_code, reason = "they are held, so that messages come")]
enum Input {
    Plain(Box<Plain<()>>),
    Latched(Box<AdvancedSubscriber<()>>),
}

impl Node {
    /// Starts to receive a topic. `take` gets each message of another session, on a thread of zenoh: it must not wait.
    ///
    /// # Errors
    /// If the session has ended.
    pub fn subscriber(
        &self,
        subject: &Subject,
        qos: TokenQos,
        bytes_max: usize,
        take: impl Fn(Incoming) + Send + Sync + 'static,
    ) -> Result<Subscriber, Error> {
        let take = move |sample: Sample| {
            if sample.kind() == SampleKind::Put {
                take(incoming(&sample, bytes_max));
            }
        };
        let subscriber = self.inner.session.declare_subscriber(subject.key(self.inner.identity.domain));
        let subscriber = subscriber.callback(take).allowed_origin(Locality::Remote);
        let input = if qos.is_latched {
            let mut history = HistoryConfig::default().detect_late_publishers();
            if let Some(depth) = qos.depth {
                history = history.max_samples(depth);
            }
            let mut latched = subscriber.history(history).subscriber_detection();
            if qos.is_reliable {
                latched = latched.recovery(RecoveryConfig::default().heartbeat());
            }
            Input::Latched(Box::new(latched.wait().map_err(failed)?))
        } else {
            Input::Plain(Box::new(subscriber.wait().map_err(failed)?))
        };
        let announced = self.announce(Kind::Subscriber, subject, qos)?;
        Ok(Subscriber { _input: input, announced })
    }
}

impl Subscriber {
    /// Its identifier.
    pub fn gid(&self) -> Gid {
        self.announced.gid
    }
}

fn incoming(sample: &Sample, bytes_max: usize) -> Incoming {
    let payload = sample.payload();
    if payload.len() > bytes_max {
        return Incoming::TooLong(payload.len());
    }
    match sample.attachment().and_then(attachment) {
        Some(attachment) => Incoming::Message(bytes_of(payload), attachment),
        None => Incoming::Malformed,
    }
}

/// The attachment in these bytes.
pub(crate) fn attachment(bytes: &ZBytes) -> Option<Attachment> {
    if bytes.len() > ATTACHMENT_BYTES_MAX {
        return None;
    }
    Attachment::parse(&bytes.to_bytes())
}

/// A copy of a payload, so that the rest of its buffer is not kept.
pub(crate) fn bytes_of(payload: &ZBytes) -> Bytes {
    Bytes::from(payload.to_bytes().into_owned())
}
