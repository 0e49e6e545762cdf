//! The samples of a topic, from the middleware and from shared memory.

use std::{collections::VecDeque, sync::Arc};

use tokio::sync::watch;

use super::transport::{Input, InputSettings, Middleware};
use crate::{
    error::{Error, Explained, Result},
    graph::{
        dds::Matched,
        qos::{Durability, Qos},
        queue::Incoming,
        shm,
    },
};

/// Where samples of a topic come in.
pub(crate) struct TopicInput {
    settings: InputSettings,
    middleware: Arc<dyn Middleware>,
    input: Box<dyn Input>,
    /// The publishers of others.
    matched: Matched,
    /// Samples that inputs before this one have received, and that were not taken yet.
    left: VecDeque<Incoming>,
    /// The quality of service that it follows.
    qos: watch::Receiver<Qos>,
    /// Samples that inputs before this one have lost.
    lost: u64,
    /// Shared memory; none if it is not used, or has ended.
    beside: Option<Box<dyn Input>>,
}

impl TopicInput {
    pub(super) async fn open(
        middleware: &Arc<dyn Middleware>,
        settings: InputSettings,
        mut qos: watch::Receiver<Qos>,
    ) -> Result<Self> {
        let first = *qos.borrow_and_update();
        let (input, matched) = opened(&**middleware, &settings, &first).await?;
        let (middleware, left) = (Arc::clone(middleware), VecDeque::new());
        Ok(Self { settings, middleware, input, matched, left, qos, lost: 0, beside: None })
    }

    /// Reads from shared memory too.
    pub(super) fn add(&mut self, beside: Option<Box<dyn Input>>) {
        self.beside = beside;
    }

    /// The next sample; none when the middleware ended. Cancelling it loses nothing.
    pub(crate) async fn next(&mut self) -> Option<Incoming> {
        if let Some(left) = self.left.pop_front() {
            return Some(left);
        }
        if let Some(beside) = &mut self.beside {
            tokio::select! {
                incoming = self.input.next() => return incoming,
                incoming = beside.next() => if incoming.is_some() {
                    return incoming;
                },
            }
            let (topic, only) = (self.settings.topic.as_str(), self.middleware.name());
            tracing::warn!(
                topic,
                "shared memory is not used for {topic} any more, only {only}, until this bridge starts again"
            );
            self.lost = self.lost.saturating_add(beside.dropped());
            self.beside = None;
        }
        self.input.next().await
    }

    /// The next sample if one waits.
    pub(crate) fn try_next(&mut self) -> Option<Incoming> {
        let next = self.left.pop_front().or_else(|| self.input.try_next());
        next.or_else(|| self.beside.as_mut()?.try_next())
    }

    /// Do its publishers keep their last samples for late subscribers?
    pub(crate) fn is_latched(&self) -> bool {
        self.qos.borrow().durability == Durability::TransientLocal
    }

    /// Is this publisher still in the graph?
    pub(crate) fn has_publisher(&self, source: &[u8; 16]) -> bool {
        self.middleware.has_publisher(source)
    }

    /// The quality of service that it follows.
    pub(crate) fn qos(&self) -> &watch::Receiver<Qos> {
        &self.qos
    }

    /// Reads with the quality of service that meets the others. Samples that the input before has received come first.
    pub(crate) async fn follow(&mut self) {
        let qos = *self.qos.borrow_and_update();
        match opened(&*self.middleware, &self.settings, &qos).await {
            Ok((input, matched)) => {
                let mut before = std::mem::replace(&mut self.input, input);
                self.matched = matched;
                self.left.extend(std::iter::from_fn(|| before.try_next()));
                self.lost = self.lost.saturating_add(before.dropped());
            }
            Err(error) => tracing::warn!(%error, "cannot change the subscription; the topic is read as before"),
        }
    }

    /// The publishers of others over the middleware.
    pub(crate) fn matched(&self) -> &Matched {
        &self.matched
    }

    /// The publishers in shared memory.
    pub(crate) fn in_memory(&self) -> Option<shm::Peers> {
        self.beside.as_ref()?.in_memory()
    }

    /// Samples lost here: replaced by newer ones, too large, or not readable.
    pub(crate) fn dropped(&self) -> u64 {
        let lost = self.lost.saturating_add(self.input.dropped());
        lost.saturating_add(self.beside.as_ref().map_or(0, |beside| beside.dropped()))
    }

    /// Loses shared memory as a fault would take it away.
    #[cfg(test)]
    pub(crate) fn break_down_shared_memory(&self) {
        self.beside.iter().for_each(|beside| beside.queue().close());
    }
}

/// An input of the middleware, with the publishers of others.
async fn opened(middleware: &dyn Middleware, settings: &InputSettings, qos: &Qos) -> Result<(Box<dyn Input>, Matched)> {
    let input = middleware.input(settings, qos).await?;
    let matched = input.matched().cloned().ok_or_else(|| unmatched(middleware.name()))?;
    Ok((input, matched))
}

/// A middleware without discovery is none.
pub(super) fn unmatched(name: &str) -> Error {
    let wanted = "a middleware that knows who publishes and subscribes";
    Error::Dds(Explained::new("the graph cannot be joined", name, wanted, ""))
}
