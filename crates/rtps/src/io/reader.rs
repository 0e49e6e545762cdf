//! Reads samples of one topic.

use super::matches::Matches;
use super::membership::{Ended, Endpoint, Membership, Role};
use super::queue::{Losses, QueueLimits, ReaderCounters, SampleQueue, queue};
use crate::guid::{EntityId, Guid};
use crate::interface::{EndpointSettings, IncomingSample, Input};
use std::sync::Arc;
use tokio::sync::watch;

/// Reads samples of one topic. Closed when dropped.
#[derive(Debug)]
pub struct DomainReader {
    membership: Arc<Membership>,
    entity: EntityId,
    matches: watch::Receiver<Matches>,
    queue: SampleQueue,
}

impl DomainReader {
    pub(super) fn open(
        membership: Arc<Membership>,
        settings: EndpointSettings,
        limits: QueueLimits,
    ) -> Result<Self, Ended> {
        let (matches_sender, matches) = watch::channel(Matches::default());
        let (sender, queue) = queue(limits);
        let topic = settings.topic.name.clone();
        let endpoint = Endpoint { topic, matches: matches_sender, role: Role::Reader(sender) };
        let entity = membership.open(Input::OpenReader(settings), endpoint)?;
        Ok(Self { membership, entity, matches, queue })
    }

    /// The next sample, as soon as there is one; none when the domain has ended. Its writer is in [`DomainReader::matches`] before.
    /// Cancelling it loses nothing.
    pub async fn next(&mut self) -> Option<IncomingSample> {
        self.queue.next().await
    }

    /// The next sample if one waits.
    pub fn try_next(&mut self) -> Option<IncomingSample> {
        self.queue.try_next()
    }

    /// Its GUID.
    pub fn guid(&self) -> Guid {
        Guid::new(self.membership.guid().prefix, self.entity)
    }

    /// The writers, of this participant as well. Closed when the domain ends.
    pub fn matches(&self) -> &watch::Receiver<Matches> {
        &self.matches
    }

    /// The samples so far that did not come through.
    pub fn losses(&self) -> Losses {
        self.queue.losses()
    }

    /// Deadlines that were missed, and writers whose numbers began again.
    pub fn counters(&self) -> ReaderCounters {
        self.queue.counters()
    }
}

impl Drop for DomainReader {
    fn drop(&mut self) {
        self.membership.close(self.entity);
    }
}
