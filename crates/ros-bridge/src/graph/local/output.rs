//! A topic on which the bridge delivers, over both transports.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use ledger_gate::sample::Sample;

use crate::{
    error::Result,
    graph::{
        dds::{Matched, Writer},
        loop_filter::Delivered,
        mark::Mark,
        qos::Qos,
        shm,
    },
};

/// Opens a writer with a quality of service.
type Open = Box<dyn Fn(&Qos) -> Result<Writer> + Send + Sync>;

/// Where samples of a topic go out.
pub(crate) struct TopicOutput {
    writer: Writer,
    /// Opens a writer in the place of the one before.
    open: Open,
    shm: Option<shm::Publisher>,
    mark: Mark,
    delivered: Arc<Delivered>,
}

impl TopicOutput {
    pub(super) fn open(open: Open, qos: &Qos, mark: Mark, delivered: Arc<Delivered>) -> Result<Self> {
        Ok(Self { writer: open(qos)?, open, shm: None, mark, delivered })
    }

    /// Writes into shared memory too.
    pub(super) fn add(&mut self, shm: Option<shm::Publisher>) {
        self.shm = shm;
    }

    /// Offers the topic with another quality of service.
    pub(crate) fn follow(&mut self, qos: &Qos) {
        match (self.open)(qos) {
            Ok(opened) => self.writer = opened,
            Err(error) => tracing::warn!(%error, "cannot change the publisher; the topic is offered as before"),
        }
    }

    /// Publishes a sample, to local processes first: that is quicker. An error concerns one of both only.
    pub(crate) fn write(&self, sample: &Sample) -> Result<()> {
        // Before it is written: an echo must not be quicker.
        self.delivered.note(self.mark, sample.wire(), Instant::now());
        let shm = self.shm.as_ref().map_or(Ok(0), |shm| shm.write(sample));
        self.writer.write(sample)?;
        shm.map(drop)
    }

    /// The subscribers of others over DDS.
    pub(crate) fn matched(&self) -> &Matched {
        self.writer.matched()
    }

    /// Subscribers in shared memory.
    pub(crate) fn in_memory(&self) -> Option<shm::Peers> {
        self.shm.as_ref().map(shm::Publisher::peers)
    }

    /// Waits until reliable readers have everything; false after `at_most`.
    pub(crate) async fn flush(&self, at_most: Duration) -> bool {
        self.writer.flush(at_most).await
    }
}
