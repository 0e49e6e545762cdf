//! A topic on which the bridge delivers, over the middleware and over shared memory.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use ledger_gate::sample::Sample;

use super::{
    input::unmatched,
    transport::{Middleware, Output, OutputSettings},
};
use crate::{
    error::Result,
    graph::{dds::Matched, loop_filter::Delivered, mark::Mark, qos::Qos, shm},
};

/// Where samples of a topic go out.
pub(crate) struct TopicOutput {
    settings: OutputSettings,
    middleware: Arc<dyn Middleware>,
    output: Box<dyn Output>,
    /// The subscribers of others.
    matched: Matched,
    /// Shared memory, if it is used.
    beside: Option<Box<dyn Output>>,
    mark: Mark,
    delivered: Arc<Delivered>,
}

impl TopicOutput {
    pub(super) async fn open(
        middleware: &Arc<dyn Middleware>,
        (settings, mark): (OutputSettings, Mark),
        qos: &Qos,
        delivered: Arc<Delivered>,
    ) -> Result<Self> {
        let (output, matched) = opened(&**middleware, &settings, qos).await?;
        Ok(Self { settings, middleware: Arc::clone(middleware), output, matched, beside: None, mark, delivered })
    }

    /// Writes into shared memory too.
    pub(super) fn add(&mut self, beside: Option<Box<dyn Output>>) {
        self.beside = beside;
    }

    /// Offers the topic with another quality of service.
    pub(crate) async fn follow(&mut self, qos: &Qos) {
        match opened(&*self.middleware, &self.settings, qos).await {
            Ok((output, matched)) => (self.output, self.matched) = (output, matched),
            Err(error) => tracing::warn!(%error, "cannot change the publisher; the topic is offered as before"),
        }
    }

    /// Publishes a sample, to local processes first: that is quicker. An error concerns one of both only.
    pub(crate) fn write(&self, sample: &Sample) -> Result<()> {
        // Before it is written: an echo must not be quicker.
        self.delivered.note(self.mark, sample.wire(), Instant::now());
        let beside = self.beside.as_ref().map_or(Ok(()), |beside| beside.write(sample));
        self.output.write(sample)?;
        beside
    }

    /// The subscribers of others over the middleware.
    pub(crate) fn matched(&self) -> &Matched {
        &self.matched
    }

    /// Subscribers in shared memory.
    pub(crate) fn in_memory(&self) -> Option<shm::Peers> {
        self.beside.as_ref()?.in_memory()
    }

    /// Waits until reliable readers have everything; false after `at_most`.
    pub(crate) async fn flush(&self, at_most: Duration) -> bool {
        self.output.flush(at_most).await
    }
}

/// An output of the middleware, with the subscribers of others.
async fn opened(
    middleware: &dyn Middleware,
    settings: &OutputSettings,
    qos: &Qos,
) -> Result<(Box<dyn Output>, Matched)> {
    let output = middleware.output(settings, qos).await?;
    let matched = output.matched().cloned().ok_or_else(|| unmatched(middleware.name()))?;
    Ok((output, matched))
}
