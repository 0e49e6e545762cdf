//! The other side: what this node gives to nodes that catch up.

use super::blocks::to_wire;
use crate::ordering::Ordering;
use crate::ordering::directory::Member;
use crate::peers::chain_monitor::ChainMonitor;
use crate::peers::quorum_certificates::Certificates;
use crate::peers::receipt;
use crate::process::clock::wall;
use crate::storage::Storage;
use ledger::branch::CertifiedBranch;
use ledger::headers::HEADERS_MAX;
use ledger_api::to_status;
use ledger_api::v1::{
    self, Attested, BlockEntries, CertifiedResponse, ChainRequest, ChainResponse, DigestResponse, SnapshotChunk,
    SnapshotResponse, WritesResponse,
};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Lane, ReceiptKey};
use ledger_replica::catch_up::{Holding, store_holds};
use ledger_replica::company::Point;
use ledger_replica::gateway::{InFlight, Shares};
use ledger_replica::trust;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

/// Bytes of blocks in one message, unless a single one is larger.
const MESSAGE_BYTES: usize = 1024 * 1024;
/// Messages read ahead for a node that is slower than this one's disk.
const AHEAD_MAX: usize = 2;
/// Streams of blocks and snapshots at a time; each takes a thread while it reads. Organisations share them as they share the
/// places of a gateway. Those who are no members are one organisation, and leave half of them free.
const STREAMS_MAX: usize = 8;

/// A reader: a member, or a node of an organisation of the network that is no member, such as one that was removed.
pub(crate) type Reader = Option<Member>;

/// The service that gives blocks and snapshots to others.
pub(crate) struct Source {
    ordering: Arc<Ordering>,
    monitor: Arc<ChainMonitor>,
    certificates: Arc<Certificates>,
    /// Makes receipts for what this node holds.
    receipts: ReceiptKey,
    streams: Shares,
}

impl Source {
    /// Gives what is in the node's stores.
    pub(crate) fn new(
        ordering: &Arc<Ordering>,
        (monitor, certificates): (&Arc<ChainMonitor>, &Arc<Certificates>),
        receipts: ReceiptKey,
    ) -> Arc<Self> {
        let (monitor, certificates) = (Arc::clone(monitor), Arc::clone(certificates));
        let (ordering, streams) = (Arc::clone(ordering), Shares::new(STREAMS_MAX));
        Arc::new(Self { ordering, monitor, certificates, receipts, streams })
    }

    fn storage(&self) -> &Storage {
        &self.ordering.storage
    }

    /// The blocks of this node, and its knowledge of the asking one. That is no member if none is given.
    pub(crate) fn chain(&self, asking: Option<&Member>, request: &ChainRequest) -> ChainResponse {
        let storage = self.storage();
        let stores = (&*storage.ledger, &*storage.log.store, &*storage.snapshots);
        let id = asking.map_or(0, |asking| asking.id);
        let confirmed = self.monitor.confirmed(id);
        let has = Holding::of(stores, self.ordering.slot.status().as_ref(), (id, confirmed.as_ref()), &self.receipts);
        let Holding { height, durable, first_height, snapshot_height, yours, receipts, you_vote, receipt } = has;
        let told = Hash::from_slice(&request.block_hash).zip(Hash::from_slice(&request.digest));
        if let (Some(asking), Some((hash, digest))) = (asking, told) {
            self.monitor.told(asking, Point { height: request.height, hash, digest });
        }
        let own = self.monitor.own(request.height).filter(|own| own.height > 0);
        let hash = |hash: fn(&Point) -> Hash| own.map(|own| hash(&own).0.to_vec().into()).unwrap_or_default();
        ChainResponse {
            compared_height: own.map_or(0, |own| own.height),
            block_hash: hash(|own| own.hash),
            digest: hash(|own| own.digest),
            stranger: asking.is_none(),
            network: self.storage().ledger.network().0.to_vec().into(),
            first_height,
            height,
            durable,
            term: self.storage().log.store.term(height).unwrap_or_default(),
            snapshot_height,
            yours,
            you_vote,
            receipts: receipts.into_iter().map(receipt::to_wire).collect(),
            receipt: receipt.map(receipt::to_wire),
            clock: wall(),
        }
    }

    /// Blocks from a height on, until the newest that is committed.
    ///
    /// # Errors
    /// [`Code::Pruned`] if they are not here any more, [`Code::Overloaded`] if too many nodes ask.
    pub(crate) fn blocks(
        self: &Arc<Self>,
        from: u64,
        reader: &Reader,
    ) -> Result<ReceiverStream<Result<BlockEntries, Status>>, Status> {
        let first = self.storage().log.store.first_index();
        if from < first {
            return Err(to_status(
                &Rejection::new(Code::Pruned, format!("block {from} is no longer stored here"))
                    .wanted(format!("height {first} or later"))
                    .next("fetch a snapshot first, or ask a node with a longer retention"),
            ));
        }
        let permit = self.permit(reader)?;
        let (messages, stream) = mpsc::channel(AHEAD_MAX);
        let source = Arc::clone(self);
        tokio::task::spawn_blocking(move || source.send_blocks(from, &messages, permit));
        Ok(ReceiverStream::new(stream))
    }

    fn send_blocks(&self, mut next: u64, messages: &mpsc::Sender<Result<BlockEntries, Status>>, _permit: InFlight) {
        loop {
            let committed = self.committed();
            if next > committed {
                return;
            }
            let message = match self.storage().log.store.entries(next..committed + 1, MESSAGE_BYTES) {
                Ok(entries) if entries.is_empty() => {
                    Err(to_status(&Rejection::new(Code::Pruned, format!("block {next} was just dropped"))))
                }
                Ok(entries) => {
                    next += entries.len() as u64;
                    Ok(BlockEntries { entries: entries.into_iter().map(to_wire).collect() })
                }
                Err(fault) => Err(to_status(&fault.into())),
            };
            let last = message.is_err();
            if messages.blocking_send(message).is_err() || last {
                return;
            }
        }
    }

    /// The last block that is committed and durable here.
    fn committed(&self) -> u64 {
        store_holds(&self.storage().log.store)
    }

    /// Block hash and state digest after a block; empty if it is not kept, or not executed yet.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn digest(&self, height: u64) -> Result<DigestResponse, Status> {
        let tip = self.storage().ledger.tip();
        let (digest, hash) = if height == tip.height {
            (tip.digest, tip.hash)
        } else {
            match self.storage().ledger.block_hashes(height).map_err(|fault| to_status(&fault))? {
                Some(block) => (block.digest, block.hash),
                None => return Ok(DigestResponse::default()),
            }
        };
        Ok(DigestResponse { digest: digest.0.to_vec().into(), block_hash: hash.0.to_vec().into() })
    }

    /// The certified part of this node's chain from a height on, or its newest certificate; empty if there is none.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) async fn certified(self: &Arc<Self>, height: u64) -> Result<CertifiedResponse, Status> {
        let ledger = &self.storage().ledger;
        if height == 0 || height > ledger.tip().height {
            return Ok(CertifiedResponse::default());
        }
        let covering = self.certificates.covering(ledger, height).await;
        let Some(proof) = covering.map_err(|fault| to_status(&fault))? else {
            // Blocks of the asking node may be higher than all that is certified here, and differ from lower ones.
            let newest = self.certificates.newest(ledger).map_err(|fault| to_status(&fault))?;
            let branch = newest.map(|newest| CertifiedBranch::of(newest.certificate).to_bytes());
            return Ok(CertifiedResponse { branch: branch.unwrap_or_default() });
        };
        let last = proof.certificate.statement.height;
        if last - height >= HEADERS_MAX as u64 {
            return Ok(CertifiedResponse::default());
        }
        let source = Arc::clone(self);
        let branch = tokio::task::spawn_blocking(move || {
            let header = |height| Ok(source.storage().blocks.get(height)?.map(|block| block.header.clone()));
            let headers = (height..=last).map(header).collect::<Result<Option<Vec<_>>, Rejection>>()?;
            headers.map(|headers| CertifiedBranch::new(headers, proof.certificate)).transpose()
        });
        let branch = branch.await.map_err(|_| Status::internal("a thread panicked"))?;
        let branch = branch.map_err(|fault| to_status(&fault))?;
        Ok(CertifiedResponse { branch: branch.map(|branch| branch.to_bytes()).unwrap_or_default() })
    }

    fn permit(&self, reader: &Reader) -> Result<InFlight, Status> {
        permit(&self.streams, reader).map_err(|overloaded| to_status(&overloaded))
    }

    /// The manifest of the newest snapshot that two organisations attest, and the transactions that attest it. While there is
    /// none, of the newest.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn snapshot(&self) -> Result<SnapshotResponse, Status> {
        let given =
            trust::given(&self.storage().ledger, &self.storage().snapshots).map_err(|fault| to_status(&fault))?;
        let Some(given) = given else { return Ok(SnapshotResponse::default()) };
        let block = |height| Ok(self.storage().blocks.get(height)?.map(|outcome| outcome.transactions.clone()));
        let attested = trust::attestations(&self.storage().ledger, &given, block).map_err(|fault| to_status(&fault))?;
        let attestations = attested.into_iter();
        let attestations =
            attestations.map(|trust::Attested { transaction, certificate }| Attested { transaction, certificate });
        Ok(SnapshotResponse { manifest: given.manifest().to_bytes(), attestations: attestations.collect() })
    }

    /// The pieces of a snapshot, from one on.
    ///
    /// # Errors
    /// [`Code::NotFound`] if it is not kept (any more), [`Code::Overloaded`] if too many nodes ask.
    pub(crate) fn chunks(
        &self,
        (height, from): (u64, u32),
        reader: &Reader,
    ) -> Result<ReceiverStream<Result<SnapshotChunk, Status>>, Status> {
        let snapshot = self.storage().snapshots.get(height).ok_or_else(|| {
            to_status(
                &Rejection::new(Code::NotFound, format!("there is no snapshot of height {height} here"))
                    .next("request the newest one"),
            )
        })?;
        let permit = self.permit(reader)?;
        let (messages, stream) = mpsc::channel(AHEAD_MAX);
        tokio::task::spawn_blocking(move || {
            let _permit = permit;
            for number in (from..).take_while(|number| (*number as usize) < snapshot.manifest().chunks.len()) {
                let chunk = snapshot.chunk(number as usize);
                let chunk = chunk.map(|data| SnapshotChunk { number, data }).map_err(|fault| to_status(&fault));
                let last = chunk.is_err();
                if messages.blocking_send(chunk).is_err() || last {
                    return;
                }
            }
        });
        Ok(ReceiverStream::new(stream))
    }

    /// The writes of a recent block.
    pub(crate) fn writes(&self, height: u64) -> WritesResponse {
        let Some(writes) = self.storage().ledger.writes(height) else { return WritesResponse::default() };
        let writes = writes.into_iter().map(|write| v1::Write {
            key: write.key,
            value_hash: write.value.map(|hash| hash.0.to_vec().into()).unwrap_or_default(),
        });
        WritesResponse { known: true, writes: writes.collect() }
    }
}

/// A stream for a reader, until it is dropped.
fn permit(streams: &Shares, reader: &Reader) -> Result<InFlight, Rejection> {
    let overloaded = |wanted: &str| {
        Rejection::new(Code::Overloaded, "too many nodes fetch from this node").wanted(wanted).next("ask another node")
    };
    if reader.is_none() && streams.in_flight() >= STREAMS_MAX / 2 {
        return Err(overloaded("a node of this network, or fewer streams than half"));
    }
    let name = reader.as_ref().map_or_else(String::new, Member::full_name);
    let refused = |refused: Rejection| match refused.code {
        Code::Overloaded => overloaded("at most as many streams per organisation as are free"),
        _ => refused,
    };
    streams.of(name).place(Lane::Data, 0).map_err(refused)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn node(organisation: &str, id: u64) -> Reader {
        let (name, address) = (format!("node{id}"), String::new());
        Some(Member { id, name, organisation: organisation.into(), address, wanted: None, actual: None })
    }

    #[test]
    fn the_nodes_of_one_organisation_leave_half_of_the_streams_to_others_and_one_node_some_to_its_own() {
        let streams = Shares::new(STREAMS_MAX);
        let all = |reader: Reader| std::iter::from_fn(|| permit(&streams, &reader).ok()).collect::<Vec<_>>();
        let one = all(node("Org1", 1));
        let crowd: Vec<_> = (2..30).flat_map(|id| all(node("Org1", id))).collect();
        assert!(!crowd.is_empty() && one.len() + crowd.len() <= STREAMS_MAX / 2, "{} and {}", one.len(), crowd.len());
        let refused = permit(&streams, &node("Org1", 30)).err().unwrap();
        assert!(refused.code == Code::Overloaded && refused.wanted.contains("organisation"), "{refused}");
        permit(&streams, &node("Org2", 31)).unwrap();
    }

    #[test]
    fn those_who_are_no_members_leave_half_of_the_streams_free() {
        let streams = Shares::new(STREAMS_MAX);
        let strangers: Vec<_> = std::iter::from_fn(|| permit(&streams, &None).ok()).collect();
        assert!((1..=STREAMS_MAX / 2).contains(&strangers.len()), "{}", strangers.len());
        permit(&streams, &node("Org1", 1)).unwrap();
    }
}
