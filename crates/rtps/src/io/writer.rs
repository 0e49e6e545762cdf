//! Writes samples of one topic.

use super::matches::Matches;
use super::membership::{Ended, Endpoint, Membership, Role};
use crate::guid::{EntityId, Guid, SequenceNumber};
use crate::interface::{EndpointSettings, Input, OutgoingSample, WriterLosses};
use crate::limits::SAMPLE_BYTES_MAX;
use std::sync::Arc;
use tokio::sync::watch;

/// Why a sample was not written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WriteError {
    /// The domain has ended.
    #[error(transparent)]
    Ended(#[from] Ended),
    /// It is larger than [`SAMPLE_BYTES_MAX`].
    #[error("a sample of {0} bytes is too large: at most {SAMPLE_BYTES_MAX}")]
    TooLarge(usize),
}

/// Writes samples of one topic. Closed when dropped.
#[derive(Debug)]
pub struct DomainWriter {
    membership: Arc<Membership>,
    entity: EntityId,
    matches: watch::Receiver<Matches>,
    acknowledged: watch::Receiver<bool>,
}

impl DomainWriter {
    pub(super) fn open(membership: Arc<Membership>, settings: EndpointSettings) -> Result<Self, Ended> {
        let (matches_sender, matches) = watch::channel(Matches::default());
        let (acknowledged_sender, acknowledged) = watch::channel(true);
        let topic = settings.topic.name.clone();
        let endpoint = Endpoint { topic, matches: matches_sender, role: Role::Writer(acknowledged_sender) };
        let entity = membership.open(Input::OpenWriter(settings), endpoint)?;
        Ok(Self { membership, entity, matches, acknowledged })
    }

    /// Writes a sample on this thread; waits neither for readers nor for the network.
    ///
    /// # Errors
    /// If the sample is too large, or the domain has ended.
    pub fn write(&self, sample: OutgoingSample) -> Result<SequenceNumber, WriteError> {
        if sample.payload.len() > SAMPLE_BYTES_MAX {
            return Err(WriteError::TooLarge(sample.payload.len()));
        }
        Ok(self.membership.write(self.entity, sample)?)
    }

    /// Its GUID.
    pub fn guid(&self) -> Guid {
        Guid::new(self.membership.guid().prefix, self.entity)
    }

    /// The readers, of this participant as well. Closed when the domain ends.
    pub fn matches(&self) -> &watch::Receiver<Matches> {
        &self.matches
    }

    /// Bytes of samples that it keeps and that not all reliable readers have.
    pub fn unacknowledged_bytes(&self) -> usize {
        self.membership.unacknowledged_bytes(self.entity)
    }

    /// The samples so far that it dropped before all reliable readers had them.
    pub fn losses(&self) -> WriterLosses {
        self.membership.writer_losses(self.entity)
    }

    /// Asserts that it is alive, as writing does. Has an effect where its kind of liveliness is a manual one.
    ///
    /// # Errors
    /// If the domain has ended.
    pub fn assert_liveliness(&self) -> Result<(), Ended> {
        self.membership.assert_liveliness(self.entity)
    }

    /// Waits until all reliable readers have everything. It waits as long as it takes: put a timeout around it.
    ///
    /// # Errors
    /// If the domain ends before.
    pub async fn acknowledged(&self) -> Result<(), Ended> {
        self.acknowledged.clone().wait_for(|is_acknowledged| *is_acknowledged).await.map(drop).map_err(|_| Ended)
    }
}

impl Drop for DomainWriter {
    fn drop(&mut self) {
        self.membership.close(self.entity);
    }
}
