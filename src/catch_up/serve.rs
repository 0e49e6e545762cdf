//! The other side: what this node gives to nodes that catch up.

use super::blocks::to_wire;
use crate::orderer::Seat;
use crate::peers::Member;
use ledger::block_store::BlockStore;
use ledger::{Code, Ledger, Rejection};
use ledger_api::to_status;
use ledger_api::v1::{BlockEntries, ChainResponse, DigestResponse};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

/// Bytes of blocks in one message, unless a single one is larger.
const MESSAGE_BYTES: usize = 1024 * 1024;
/// Messages read ahead for a node that is slower than this one's disk.
const AHEAD_MAX: usize = 2;
/// Streams of blocks at a time; each takes a thread while it reads.
const STREAMS_MAX: usize = 8;

/// What this node gives to others.
pub(crate) struct Source {
    ledger: Arc<Ledger>,
    store: Arc<BlockStore>,
    seat: Arc<Seat>,
    streams: Arc<Semaphore>,
}

impl Source {
    /// Gives what is in these stores.
    pub(crate) fn new(ledger: Arc<Ledger>, store: Arc<BlockStore>, seat: Arc<Seat>) -> Self {
        Self { ledger, store, seat, streams: Arc::new(Semaphore::new(STREAMS_MAX)) }
    }

    /// What this node has, and what it knows of the asking one.
    pub(crate) fn chain(&self, asking: &Member) -> ChainResponse {
        let height = self.committed();
        let status = self.seat.status();
        let peers = status.iter().flat_map(|status| &status.peers);
        let acknowledged = peers.filter(|peer| peer.node == asking.id).map(|peer| peer.matched).max();
        ChainResponse {
            network: self.ledger.network().0.to_vec().into(),
            first_height: self.store.first_index(),
            height,
            term: self.store.term(height).unwrap_or_default(),
            snapshot_height: 0,
            yours: acknowledged.unwrap_or_default(),
            you_vote: asking.votes(),
        }
    }

    /// Blocks from a height on, until the newest that is committed.
    ///
    /// # Errors
    /// [`Code::Pruned`] if they are not here any more, [`Code::Overloaded`] if too many nodes ask.
    pub(crate) fn blocks(self: &Arc<Self>, from: u64) -> Result<ReceiverStream<Result<BlockEntries, Status>>, Status> {
        let first = self.store.first_index();
        if from < first {
            return Err(to_status(
                &Rejection::new(Code::Pruned, format!("block {from} is not kept here any more"))
                    .wanted(format!("height {first} or later"))
                    .next("take a snapshot first, or ask a node that keeps more"),
            ));
        }
        let permit = Arc::clone(&self.streams).try_acquire_owned().map_err(|_| {
            to_status(
                &Rejection::new(Code::Overloaded, "too many nodes fetch blocks from here").next("ask another node"),
            )
        })?;
        let (messages, stream) = mpsc::channel(AHEAD_MAX);
        let source = Arc::clone(self);
        tokio::task::spawn_blocking(move || source.send_blocks(from, &messages, permit));
        Ok(ReceiverStream::new(stream))
    }

    fn send_blocks(
        &self,
        mut next: u64,
        messages: &mpsc::Sender<Result<BlockEntries, Status>>,
        _permit: OwnedSemaphorePermit,
    ) {
        loop {
            let committed = self.committed();
            if next > committed {
                return;
            }
            let message = match self.store.entries(next..committed + 1, MESSAGE_BYTES) {
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

    /// What is committed and durable here.
    fn committed(&self) -> u64 {
        self.store.committed().min(self.store.durable_index())
    }

    /// Block hash and state digest after a block; empty if it is not kept, or not executed yet.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn digest(&self, height: u64) -> Result<DigestResponse, Status> {
        let tip = self.ledger.tip();
        let (digest, hash) = if height == tip.height {
            (tip.digest, tip.hash)
        } else {
            match self.ledger.result(height).map_err(|fault| to_status(&fault))? {
                Some(result) => (result.digest(), result.header(height).hash()),
                None => return Ok(DigestResponse::default()),
            }
        };
        Ok(DigestResponse { digest: digest.0.to_vec().into(), block_hash: hash.0.to_vec().into() })
    }
}
