//! Where messages go out.

use std::time::Duration;

use ledger_gate::sample::Sample;

use super::handover::Hand;
use crate::{
    error::Result,
    graph::{dds::Matched, local::TopicOutput, qos::Qos, shm},
};

/// Where messages go out.
pub(in crate::routes) enum Outlet {
    /// To a topic.
    Topic(Box<TopicOutput>),
    /// To the local part of a route of calls.
    Calls(Hand),
}

impl Outlet {
    /// Offers the topic with another quality of service.
    pub(in crate::routes) async fn follow(&mut self, qos: &Qos) {
        if let Self::Topic(topic) = self {
            topic.follow(qos).await;
        }
    }

    /// The number of subscribers, over DDS and in shared memory.
    pub(in crate::routes) fn listeners(&self) -> usize {
        self.matched().now().matched + self.in_memory().map_or(0, |peers| peers.count())
    }

    /// Publishes a sample: see [`TopicOutput::write`].
    pub(in crate::routes) fn write(&self, sample: &Sample) -> Result<()> {
        match self {
            Self::Topic(topic) => topic.write(sample),
            Self::Calls(_) => Ok(()),
        }
    }

    /// The local part of a route of calls: it takes whole messages.
    pub(in crate::routes) fn hand(&mut self) -> Option<&mut Hand> {
        match self {
            Self::Calls(hand) => Some(hand),
            Self::Topic(_) => None,
        }
    }

    /// Subscribers in shared memory.
    pub(in crate::routes) fn in_memory(&self) -> Option<shm::Peers> {
        match self {
            Self::Topic(topic) => topic.in_memory(),
            Self::Calls(_) => None,
        }
    }

    /// The subscribers of others.
    pub(in crate::routes) fn matched(&self) -> &Matched {
        match self {
            Self::Topic(topic) => topic.matched(),
            Self::Calls(hand) => hand.matched(),
        }
    }

    /// Waits until reliable readers have everything; false after `at_most`.
    pub(in crate::routes) async fn flush(&self, at_most: Duration) -> bool {
        match self {
            Self::Topic(topic) => topic.flush(at_most).await,
            Self::Calls(_) => true,
        }
    }
}
