//! The presence of a bridge in the local graph: every topic over DDS, and beside it in shared memory.

mod input;
mod output;

use std::sync::Arc;

use tokio::sync::watch;

pub(crate) use self::{input::TopicInput, output::TopicOutput};
use super::{
    dds::Participant,
    loop_filter::{Delivered, LoopFilter},
    mark::Mark,
    names::{TopicName, TypeName},
    qos::Qos,
    queue::Limits,
    reach::Reach,
    shm,
};
use crate::error::{Error, Result};

/// Our presence in the local graph: one participant and one origin for all routes, so that nothing a bridge
/// publishes is taken in by it again.
#[derive(Clone)]
pub(crate) struct LocalGraph {
    participant: Participant,
    shm: Option<shm::Node>,
    delivered: Arc<Delivered>,
}

impl LocalGraph {
    /// Joins a ROS domain.
    ///
    /// # Errors
    /// As [`Participant::join`]; without shared memory only DDS is used.
    pub(crate) async fn join(domain: u16, reach: &Reach, node_name: &str, shared_memory: bool) -> Result<Self> {
        let participant = Participant::join(domain, node_name, reach).await?;
        let (origin, name) = (participant.guid(), shm::bridge_name(node_name, participant.guid()));
        let shm = match shared_memory {
            true => or_dds_only("any topic", shm::Node::open(domain, &name, origin).await),
            false => None,
        };
        Ok(Self { participant, shm, delivered: Arc::default() })
    }

    /// The participant of DDS.
    pub(crate) fn participant(&self) -> &Participant {
        &self.participant
    }

    /// The known deliveries of bridges to this graph.
    pub(crate) fn delivered(&self) -> &Arc<Delivered> {
        &self.delivered
    }

    /// Reads a topic behind a filter. It follows the quality of service.
    ///
    /// # Errors
    /// As [`Participant::reader_behind`].
    pub(crate) async fn input(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: watch::Receiver<Qos>,
        limits: Limits,
        filter: Arc<LoopFilter>,
    ) -> Result<TopicInput> {
        let open = {
            let (participant, topic, message, filter) =
                (self.participant.clone(), topic.clone(), message.clone(), Arc::clone(&filter));
            move |qos: &Qos| participant.reader_behind(&topic, &message, qos, limits, Arc::clone(&filter))
        };
        let mut input = TopicInput::open(topic.clone(), Box::new(open), qos, self.participant.clone())?;
        if let Some(node) = &self.shm {
            input.add(or_dds_only(topic.as_str(), node.subscriber_behind(topic, limits, filter).await));
        }
        Ok(input)
    }

    /// Writes on a topic, with the mark of a service.
    ///
    /// # Errors
    /// As [`Participant::marked_writer`].
    pub(crate) async fn output(
        &self,
        topic: &TopicName,
        message: &TypeName,
        qos: &Qos,
        mark: Mark,
    ) -> Result<TopicOutput> {
        self.delivered.begins(mark);
        let open = {
            let (participant, topic, message) = (self.participant.clone(), topic.clone(), message.clone());
            move |qos: &Qos| participant.marked_writer(&topic, &message, qos, mark)
        };
        let mut output = TopicOutput::open(Box::new(open), qos, mark, Arc::clone(&self.delivered))?;
        if let Some(node) = &self.shm {
            output.add(or_dds_only(topic.as_str(), node.marked_publisher(topic, mark).await));
        }
        Ok(output)
    }
}

/// Shared memory that cannot be used does not keep a topic from DDS.
fn or_dds_only<T>(topic: &str, opened: Result<T>) -> Option<T> {
    let warn = |error: &Error| {
        tracing::warn!(topic, %error, "shared memory is not used for {topic}, only DDS, until this bridge starts again");
    };
    opened.inspect_err(warn).ok()
}
