//! A local topic on which a route shows something: who comes later hears the last message.

use ledger_base::rejection::Rejection;
use ros_message::Message;
use serde_json::Value;

use crate::graph::{
    local::{LocalGraph, TopicOutput},
    mark::Mark,
    messages::builtin,
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
};

const QOS: Qos = Qos::new(Reliability::Reliable, Durability::TransientLocal, 1);

/// The topic.
pub(crate) struct LatchedTopic {
    outlet: TopicOutput,
    message: Message,
}

impl LatchedTopic {
    /// Offers the topic, if one is set. `message` is a built-in type.
    pub(crate) async fn open(
        topic: Option<&TopicName>,
        message: &str,
        local: &LocalGraph,
        mark: Mark,
    ) -> Result<Option<Self>, Rejection> {
        let Some(topic) = topic else { return Ok(None) };
        let outlet = local.output(topic, &TypeName::parse(message)?, &QOS, mark).await?;
        Ok(Some(Self { outlet, message: builtin::of(message)? }))
    }

    /// Publishes a message with these values, or says why not.
    pub(crate) fn write(&self, value: &Value) -> Result<(), String> {
        let sample = builtin::sample(&self.message, value).map_err(|refused| refused.to_string())?;
        self.outlet.write(&sample).map_err(|error| error.to_string())
    }
}
