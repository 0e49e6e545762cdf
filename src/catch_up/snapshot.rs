//! Taking a snapshot from another node, if nobody has the blocks any more that this node lacks.
//!
//! The manifest comes first, with the attestations of its content. Nothing is fetched unless an organisation that this
//! node trusts attests it; nothing is used unless it is attested as [`super::trust`] wants, which is only known when the
//! organisations inside of the snapshot are. Chunks that are there after an interruption are not fetched again.

use super::ask::Offer;
use super::blocks::{in_time, is_own};
use super::trust::{ATTESTED_MAX, Claim};
use super::{CatchUp, Caught};
use bytes::Bytes;
use ledger::network::FoundingOrganisation;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{SnapshotChunksRequest, SnapshotRequest};
use ledger_hash::Hash;
use ledger_identity::Identity;
use ledger_identity::msp::{Msp, Msps};
use ledger_rejection::{Code, Rejection};
use ledger_storage::block_store::Base;
use ledger_storage::snapshot::{CHUNK_BYTES_MAX, MANIFEST_BYTES_MAX, Manifest, Snapshot, Snapshots};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// Where the organisations stand in the world state.
const ORGANISATION_KEYS: &[u8] = b"msp\0organisation/";
/// Organisations that are looked at.
const ORGANISATIONS_MAX: usize = 1000;
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
        let claim = self.claim(&manifest)?;
        let (trusted, vouched) = (self.dialer.trust.msps(), self.bootstrap.as_ref().filter(|_| offer.vouched));
        let revoked = |identity: &Identity| self.shared.ledger.check_revoked(identity).is_err();
        if vouched.is_none() && claim.attested_by(&answer.attestations, &trusted, &revoked).is_empty() {
            return Err(Rejection::new(Code::Untrusted, "no organisation that this node trusts attests the snapshot")
                .found(format!("height {}, {} attestations", claim.height, answer.attestations.len()))
                .wanted("a node of an organisation that this node knows")
                .next("wait until the nodes have attested it, which takes some seconds"));
        }
        tracing::info!(
            peer = %offer.member.full_name(), height = claim.height, content = %claim.content, bytes = manifest.bytes(),
            "fetching a snapshot"
        );
        self.seat.show_progress(claim.height);
        let (chunks, received) = mpsc::channel(AHEAD_MAX);
        let shared = Arc::clone(&self.shared);
        let (wanted, from) = tokio::sync::oneshot::channel();
        let (attested, ca) = (answer.attestations, vouched.map(|vouched| vouched.ca));
        let gathering = tokio::task::spawn_blocking(move || {
            gather(&shared.snapshots, manifest, wanted, received, |snapshot| {
                let revoked = |identity: &Identity| shared.ledger.check_revoked(identity).is_err();
                let declared = declared(snapshot)?;
                let trusted = with_ca(&trusted, &declared, ca)?;
                claim.accept(&attested, &trusted, &declared, &revoked)
            })
        });
        if let Ok(Some(from)) = from.await {
            let request = SnapshotChunksRequest { height: claim.height, from_chunk: from };
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

    /// What the manifest claims, if it is of use here.
    fn claim(&self, manifest: &Manifest) -> Result<Claim, Rejection> {
        let (network, tip) = (self.shared.ledger.network(), self.shared.ledger.tip());
        if manifest.network != network || manifest.height <= tip.height {
            return Err(Rejection::new(Code::WrongNetwork, "the snapshot is of no use here")
                .found(format!("height {} of network {}", manifest.height, manifest.network))
                .wanted(format!("above height {} of network {network}", tip.height)));
        }
        Ok(Claim { network, height: manifest.height, time: manifest.tip.time, content: manifest.content() })
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
    accept: impl FnOnce(&Snapshot) -> Result<(), Rejection>,
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
    match installer.complete().and_then(|snapshot| accept(&snapshot)) {
        Ok(()) => installer.accept(),
        Err(refused) => {
            installer.discard()?;
            Err(refused)
        }
    }
}

/// The organisations of the network, by the snapshot itself.
fn declared(snapshot: &Snapshot) -> Result<Msps, Rejection> {
    let mut msps = Msps::new();
    for (_, value) in snapshot.pairs(ORGANISATION_KEYS, ORGANISATIONS_MAX)? {
        let read = serde_json::from_slice(&value);
        let FoundingOrganisation { name, roots, intermediates } = read.map_err(|error| {
            Rejection::new(Code::Malformed, format!("an organisation in the snapshot cannot be read: {error}"))
        })?;
        let msp = Msp::new(&name, &roots, &intermediates).map_err(Rejection::from)?;
        msps.insert(msp).map_err(Rejection::from)?;
    }
    Ok(msps)
}

/// Whom this node trusts: those it knows, and the organisation behind the CA that its join token names.
fn with_ca(known: &Msps, declared: &Msps, ca: Option<Hash>) -> Result<Msps, Rejection> {
    let mut trusted = known.clone();
    let is_named = |msp: &&Msp| msp.roots().any(|root| Some(Hash::of(&[root])) == ca);
    if let Some(named) = declared.iter().find(is_named).filter(|named| trusted.get(named.organisation()).is_none()) {
        trusted.insert(named.clone()).map_err(Rejection::from)?;
    }
    Ok(trusted)
}
