//! Publishes raw CDR on one topic.

use bytes::Bytes;
use ledger_gate::sample::Sample;
use ros_zenoh::{publisher::Publisher, token::Kind};

use super::{
    failure::zenoh_error,
    matching::Matching,
    session::{Session, token_qos},
};
use crate::{
    error::Result,
    graph::{
        dds::Matched,
        mark::Mark,
        names::{TopicName, TypeName},
        qos::Qos,
    },
};

/// A sample up to this size is copied: a latched topic would keep the whole buffer in memory in which it came.
const COPIED_BYTES_MAX: usize = 4 * 1024;

/// Offers one topic; leaves it when dropped. Writing waits for no subscriber.
pub(crate) struct Writer {
    topic: TopicName,
    publisher: Publisher,
    matching: Matching,
}

impl Session {
    /// Starts to offer a topic, with a mark where samples come from the ledger.
    pub(crate) fn writer(
        &self,
        (topic, message): (&TopicName, &TypeName),
        qos: &Qos,
        mark: Option<Mark>,
    ) -> Result<Writer> {
        qos.validate()?;
        let subject = self.topic(topic, message);
        let publisher = self.node.publisher(&subject, token_qos(qos, mark));
        let publisher = publisher.map_err(|error| zenoh_error(&format!("cannot write topic {topic}"), &error))?;
        let matching = Matching::follow(&self.node, (subject, Kind::Subscriber), |_| (), || ());
        Ok(Writer { topic: topic.clone(), publisher, matching })
    }
}

impl Writer {
    /// Publishes a sample. [`crate::error::Error::Zenoh`] means that the session has ended.
    pub(crate) fn write(&self, sample: &Sample) -> Result<()> {
        let wire = sample.wire();
        let payload = if wire.len() <= COPIED_BYTES_MAX { Bytes::copy_from_slice(wire) } else { wire.clone() };
        let published = self.publisher.publish(payload);
        published.map_err(|error| zenoh_error(&format!("cannot publish on {}", self.topic), &error))
    }

    /// The subscribers of others.
    pub(crate) fn matched(&self) -> &Matched {
        &self.matching.matched
    }
}
