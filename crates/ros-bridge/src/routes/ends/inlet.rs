//! Where samples come in.

use std::sync::Arc;

use tokio::sync::watch;

use crate::graph::{
    dds::Matched,
    local::TopicInput,
    qos::Qos,
    queue::{Incoming, Queue},
};

/// Where samples come in.
pub(in crate::routes) enum Inlet {
    /// From a topic.
    Topic(Box<TopicInput>),
    /// From the local part of a route of calls.
    Calls(Arc<Queue>),
}

impl Inlet {
    /// The next sample; none when the middleware ended. Cancelling it loses nothing.
    pub(in crate::routes) async fn next(&mut self) -> Option<Incoming> {
        match self {
            Self::Topic(topic) => topic.next().await,
            Self::Calls(queue) => queue.next().await,
        }
    }

    /// The next sample if one waits.
    pub(in crate::routes) fn try_next(&mut self) -> Option<Incoming> {
        match self {
            Self::Topic(topic) => topic.try_next(),
            Self::Calls(queue) => queue.try_next(),
        }
    }

    /// Do its publishers keep their last samples for late subscribers?
    pub(in crate::routes) fn is_latched(&self) -> bool {
        matches!(self, Self::Topic(topic) if topic.is_latched())
    }

    /// Is this publisher still in the graph?
    pub(in crate::routes) fn has_publisher(&self, source: &[u8; 16]) -> bool {
        matches!(self, Self::Topic(topic) if topic.has_publisher(source))
    }

    /// The quality of service that it follows: see [`Inlet::follow`].
    pub(in crate::routes) fn qos(&self) -> Option<&watch::Receiver<Qos>> {
        match self {
            Self::Topic(topic) => Some(topic.qos()),
            Self::Calls(_) => None,
        }
    }

    /// Reads with the quality of service that meets the others; returns who they are now. Samples that the reader before has
    /// received come first.
    pub(in crate::routes) async fn follow(&mut self) -> Option<Matched> {
        let Self::Topic(topic) = self else { return None };
        topic.follow().await;
        Some(topic.matched().clone())
    }

    /// Samples lost here: replaced by newer ones, too large, or not readable.
    pub(in crate::routes) fn dropped(&self) -> u64 {
        match self {
            Self::Topic(topic) => topic.dropped(),
            Self::Calls(queue) => queue.dropped(),
        }
    }
}
