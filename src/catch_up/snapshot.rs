//! Taking a snapshot from another node, if nobody has the blocks any more that this node lacks.
//!
//! The manifest comes first, with the attestations of its content. Nothing is fetched unless an organisation that this
//! node trusts attests it. Nothing is used unless it is attested as [`ledger_replica::trust`] wants, which is only
//! known when the organisations inside of the snapshot are. Chunks that are there after an interruption are not fetched
//! again.

use super::ask::Offer;
use super::blocks::{in_time, is_own};
use super::{CatchUp, Caught};
use bytes::Bytes;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{Attested, SnapshotChunksRequest, SnapshotRequest};
use ledger_rejection::{Code, Rejection};
use ledger_replica::trust::{self, ATTESTED_MAX, Trial};
use ledger_storage::block_store::Base;
use ledger_storage::snapshot::{CHUNK_BYTES_MAX, MANIFEST_BYTES_MAX, Manifest, Snapshot, Snapshots};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// Space for attestations in the answer with a manifest.
const ATTESTED_BYTES_MAX: usize = ATTESTED_MAX * 16 * 1024;
/// Chunks on their way from the network to the disk.
const AHEAD_MAX: usize = 4;
/// How often progress is told.
const PROGRESS_PERIOD: Duration = Duration::from_secs(2);

impl CatchUp {
    /// Takes the newest snapshot that is believed, of the nodes that have one.
    ///
    /// # Errors
    /// A fault of this node's disk.
    pub(super) async fn take_snapshot(&self, offers: &[Offer]) -> Result<Caught, Rejection> {
        let height = self.shared.ledger.tip().height;
        let mut offers: Vec<_> = offers.iter().filter(|offer| offer.chain.snapshot_height > height).collect();
        offers.sort_by_key(|offer| std::cmp::Reverse(offer.chain.snapshot_height));
        for offer in offers {
            if self.is_stopping() {
                break;
            }
            match self.snapshot_from(offer).await {
                Ok(caught) => return Ok(caught),
                Err(fault) if is_own(&fault) => return Err(fault),
                Err(fault) => {
                    tracing::warn!(peer = %offer.member.full_name(), %fault, "cannot use the snapshot of this peer");
                }
            }
        }
        Ok(Caught::Nothing)
    }

    async fn snapshot_from(&self, offer: &Offer) -> Result<Caught, Rejection> {
        let refused = |status: tonic::Status| ledger_api::from_status(&offer.member.address, &status);
        let mut client = PeerClient::new(offer.channel.clone())
            .max_decoding_message_size(MANIFEST_BYTES_MAX + CHUNK_BYTES_MAX + ATTESTED_BYTES_MAX);
        let answer = in_time(client.snapshot(SnapshotRequest {})).await?.map_err(refused)?.into_inner();
        let manifest = Manifest::from_bytes(&answer.manifest)?;
        let vouched = self.bootstrap.as_ref().filter(|_| offer.vouched).map(|known| known.ca);
        let attested = answer
            .attestations
            .into_iter()
            .map(|Attested { transaction, certificate }| trust::Attested { transaction, certificate });
        let trial = Trial::begin(&self.shared.ledger, &manifest, attested.collect(), vouched)?;
        let (height, content) = (manifest.height, manifest.content());
        tracing::info!(
            peer = %offer.member.full_name(), height, content = %content, bytes = manifest.bytes(),
            "fetching a snapshot"
        );
        self.seat.show_progress(height);
        let (chunks, received) = mpsc::channel(AHEAD_MAX);
        let shared = Arc::clone(&self.shared);
        let (wanted, from) = tokio::sync::oneshot::channel();
        let gathering =
            tokio::task::spawn_blocking(move || gather(&shared.snapshots, manifest, wanted, received, &trial));
        if let Ok(Some(from)) = from.await {
            let request = SnapshotChunksRequest { height, from_chunk: from };
            let mut stream = in_time(client.snapshot_chunks(request)).await?.map_err(refused)?.into_inner();
            while let Some(chunk) = in_time(stream.message()).await?.map_err(refused)? {
                // A receiver that is gone says why below.
                if self.is_stopping() || chunks.send(chunk.data).await.is_err() {
                    break;
                }
            }
        }
        drop(chunks);
        let gathered = gathering.await;
        let snapshot = gathered.map_err(|_| Rejection::new(Code::Internal, "a thread panicked with a snapshot"))??;
        self.use_snapshot(snapshot).await
    }

    /// Lets the log begin after a snapshot that is believed. The world state follows when the node starts again: what is
    /// in memory and in use cannot be exchanged.
    async fn use_snapshot(&self, snapshot: Arc<Snapshot>) -> Result<Caught, Rejection> {
        let store = Arc::clone(&self.shared.store);
        let tip = snapshot.manifest().tip.clone();
        let base = Base { index: tip.height, term: tip.term };
        let begun = tokio::task::spawn_blocking(move || store.begin_after(base)).await;
        begun.map_err(|_| Rejection::new(Code::Internal, "a thread panicked with the log"))??;
        tracing::info!(height = tip.height, digest = %tip.digest, "a snapshot replaces the dropped blocks");
        Ok(Caught::Snapshot)
    }
}

/// Puts chunks into a snapshot until it is complete and `accept` agrees. First tells which chunk is wanted first.
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
            return Err(Rejection::new(Code::Unreachable, "the snapshot broke off")
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
