//! Fetching a snapshot from another node, if nobody has the blocks any more that this node lacks.
//!
//! The manifest comes first, with the attestations of its content. Whether it is worth fetching, and whether it is
//! believed when it is there, is decided by [`ledger_replica::trust`]. Chunks that are there after an interruption are not
//! fetched again.

use super::BlockSync;
use super::blocks::in_time;
use crate::peers::question::Contact;
use bytes::Bytes;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{SnapshotChunksRequest, SnapshotRequest};
use ledger_base::rejection::{Code, Rejection};
use ledger_replica::catch_up::Got;
use ledger_replica::trust::{ATTESTED_MAX, Attested, Trial};
use ledger_storage::snapshot::{CHUNK_BYTES_MAX, MANIFEST_BYTES_MAX, Manifest, Snapshot, Snapshots};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tonic::transport::Channel;

/// Space for attestations in the answer with a manifest.
const ATTESTED_BYTES_MAX: usize = ATTESTED_MAX * 16 * 1024;
/// Chunks on their way from the network to the disk.
const AHEAD_MAX: usize = 4;
/// How often progress is told.
const PROGRESS_PERIOD: Duration = Duration::from_secs(2);

/// The manifest of a node's newest snapshot, and the attestations of it.
pub(super) async fn manifest(peer: &Contact) -> Result<(Manifest, Vec<Attested>), Rejection> {
    let answer = in_time(client(peer).snapshot(SnapshotRequest {})).await?;
    let answer = answer.map_err(|status| ledger_api::from_status(&peer.address, &status))?.into_inner();
    let attested = answer.attestations.into_iter().map(|one| {
        let ledger_api::v1::Attested { transaction, certificate } = one;
        Attested { transaction, certificate }
    });
    Ok((Manifest::from_bytes(&answer.manifest)?, attested.collect()))
}

fn client(peer: &Contact) -> PeerClient<Channel> {
    let size = MANIFEST_BYTES_MAX + CHUNK_BYTES_MAX + ATTESTED_BYTES_MAX;
    PeerClient::new(peer.channel.clone()).max_decoding_message_size(size)
}

impl BlockSync {
    /// Fetches the chunks that are missing, and lets the trial conclude.
    pub(super) async fn fetch(&self, peer: &Contact, manifest: Manifest, trial: Trial) -> Got<Contact> {
        let (height, snapshots) = (manifest.height, Arc::clone(&self.ordering.storage.snapshots));
        let (chunks, received) = mpsc::channel(AHEAD_MAX);
        let (wanted, from) = tokio::sync::oneshot::channel();
        let gathering = tokio::task::spawn_blocking(move || gather(&snapshots, manifest, wanted, received, &trial));
        if let Ok(Some(from_chunk)) = from.await
            && let Err(refused) = self.chunks(peer, SnapshotChunksRequest { height, from_chunk }, chunks).await
        {
            return Got::Unfetched(refused);
        }
        let panicked = |_| Err(Rejection::new(Code::Internal, "a thread panicked with a snapshot"));
        Got::Snapshot(gathering.await.unwrap_or_else(panicked))
    }

    /// Passes on the chunks that a peer sends. A fault is the peer's.
    async fn chunks(
        &self,
        peer: &Contact,
        request: SnapshotChunksRequest,
        to: mpsc::Sender<Bytes>,
    ) -> Result<(), Rejection> {
        let refused = |status: tonic::Status| ledger_api::from_status(&peer.address, &status);
        let mut stream = in_time(client(peer).snapshot_chunks(request)).await?.map_err(refused)?.into_inner();
        while let Some(chunk) = in_time(stream.message()).await?.map_err(refused)? {
            // A receiver that is gone says why itself.
            if self.is_stopping() || to.send(chunk.data).await.is_err() {
                break;
            }
        }
        Ok(())
    }
}

/// Puts chunks into a snapshot until it is complete and believed. First tells which chunk is wanted first.
fn gather(
    snapshots: &Snapshots,
    manifest: Manifest,
    wanted: tokio::sync::oneshot::Sender<Option<u32>>,
    mut chunks: mpsc::Receiver<Bytes>,
    trial: &Trial,
) -> Result<Arc<Snapshot>, Rejection> {
    if let Some(known) = snapshots.get(manifest.height).filter(|known| known.content() == manifest.content()) {
        // It was believed before, and the node ended before it was used.
        let _gone = wanted.send(None);
        return Ok(known);
    }
    let all = manifest.chunks.len();
    let mut installer = snapshots.install(manifest)?;
    let _gone = wanted.send(installer.wanted().and_then(|wanted| u32::try_from(wanted).ok()));
    let mut told = Instant::now();
    while let Some(next) = installer.wanted() {
        let Some(chunk) = chunks.blocking_recv() else {
            return Err(Rejection::new(Code::Unreachable, "the snapshot transfer was interrupted")
                .found(format!("{next} of {all} chunks"))
                .next("the rest is fetched in a moment"));
        };
        installer.put(&chunk)?;
        if told.elapsed() > PROGRESS_PERIOD {
            told = Instant::now();
            tracing::info!(chunk = next, of = all, "fetching a snapshot");
        }
    }
    trial.conclude(installer)
}
