//! A local topic on which a route shows something: who comes later hears the last message.

use ledger_base::rejection::Rejection;
use ros_message::Message;
use serde_json::Value;

use super::local::{Local, Outlet};
use crate::{
    mark::Mark,
    names::{TopicName, TypeName},
    qos::{Durability, Qos, Reliability},
    typed,
};

const QOS: Qos =
    Qos { reliability: Reliability::Reliable, durability: Durability::TransientLocal, depth: 1, keyed: false };

/// The topic.
pub(super) struct Latched {
    outlet: Outlet,
    message: Message,
}

impl Latched {
    /// Offers the topic, if one is set. `message` is a built-in type.
    pub(super) async fn open(
        topic: Option<&TopicName>,
        message: &str,
        local: &Local,
        mark: Mark,
    ) -> Result<Option<Self>, Rejection> {
        let Some(topic) = topic else { return Ok(None) };
        let outlet = local.outlet(topic, &TypeName::parse(message)?, &QOS, mark).await?;
        Ok(Some(Self { outlet, message: typed::of(message)? }))
    }

    /// Publishes a message with these values, or says why not.
    pub(super) fn write(&self, value: &Value) -> Result<(), String> {
        let sample = typed::sample(&self.message, value).map_err(|refused| refused.to_string())?;
        self.outlet.write(&sample).map_err(|error| error.to_string())
    }
}
