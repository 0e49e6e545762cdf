//! Pulling blocks: in batches, each confirmed before it is stored, each stored before it is executed.

use super::ask::Offer;
use super::{Behind, CatchUp, Caught};
use ledger::block::{Header, PAYLOAD_BYTES_MAX};
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{BlockEntries, BlockEntry, BlocksRequest, DigestRequest};
use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};
use ledger_storage::block_store::BlockStore;
use ledger_storage::entry::{Entry, EntryKind, HardState};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tonic::Streaming;
use tonic::transport::Channel;

/// Bytes of blocks that are stored and executed at once.
const BATCH_BYTES: usize = 4 * 1024 * 1024;
/// Blocks in a batch at most: many may be empty.
const BATCH_BLOCKS_MAX: usize = 16_384;
/// Most bytes of one message: a block of the largest size, and what is around it.
const MESSAGE_BYTES_MAX: usize = PAYLOAD_BYTES_MAX + 2 * 1024 * 1024;
/// Time in which the next message, or a confirmation, must come.
const SILENCE_MAX: Duration = Duration::from_secs(5);
/// Results and world state in memory that are stored before going on.
const PENDING_BYTES_MAX: usize = 16 * 1024 * 1024;
/// How often progress is told.
const PROGRESS_PERIOD: Duration = Duration::from_secs(2);

/// Where the verified chain ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct End {
    height: u64,
    term: u64,
    time: u64,
    hash: Hash,
}

/// Blocks that follow an end, with the end that they lead to.
struct Batch {
    entries: Vec<Entry>,
    hashes: Vec<Hash>,
    end: End,
}

impl CatchUp {
    /// Pulls blocks from one node after the other, as long as one of them has more and is believed.
    pub(super) async fn pull(&self, offers: &[Offer], behind: Option<Behind>) -> Result<Caught, Rejection> {
        let begun = self.shared.ledger.tip().height;
        let until = offers.iter().map(|offer| offer.chain.height).max().unwrap_or_default();
        for offer in offers {
            let next = self.shared.ledger.tip().height + 1;
            let enough = behind.is_none_or(|behind| next >= behind.first_index) && next > offer.chain.height;
            if enough || self.is_stopping() {
                break;
            }
            if offer.chain.height < next || offer.chain.first_height > next {
                continue;
            }
            let confirming = match self.confirming(offer, offers, behind) {
                Ok(confirming) => confirming,
                Err(Unconfirmed) => {
                    tracing::info!(peer = %offer.member.full_name(), "no node of another organisation confirms the blocks of this peer");
                    continue;
                }
            };
            tracing::info!(peer = %offer.member.full_name(), from = next, to = until, "fetching blocks");
            self.seat.show_progress(until);
            if let Err(fault) = self.pull_from(offer, confirming, until).await {
                if is_own(&fault) {
                    return Err(fault);
                }
                tracing::warn!(peer = %offer.member.full_name(), %fault, "cannot fetch more blocks from this peer");
            }
        }
        let reached = self.shared.ledger.tip().height;
        if reached > begun {
            tracing::info!(blocks = reached - begun, height = reached, "caught up");
        }
        let wanted = behind.map_or(0, |behind| behind.first_index.saturating_sub(1));
        Ok(if reached >= wanted { Caught::Up } else { Caught::Nothing })
    }

    /// The nodes that must agree with what this one gives: none if it is believed by itself.
    fn confirming(&self, offer: &Offer, offers: &[Offer], behind: Option<Behind>) -> Result<Vec<Offer>, Unconfirmed> {
        let own = &self.dialer.organisation;
        if offer.vouched
            || offer.member.organisation == *own
            || behind.is_some_and(|behind| behind.from == offer.member.id)
        {
            return Ok(Vec::new());
        }
        let others = offers.iter().filter(|other| other.member.organisation != offer.member.organisation);
        let others: Vec<_> = others.cloned().collect();
        if others.is_empty() { Err(Unconfirmed) } else { Ok(others) }
    }

    async fn pull_from(&self, offer: &Offer, confirming: Vec<Offer>, until: u64) -> Result<(), Rejection> {
        let tip = self.shared.ledger.tip();
        let mut end = End { height: tip.height, term: tip.term, time: tip.time, hash: tip.hash };
        let mut client = PeerClient::new(offer.channel.clone()).max_decoding_message_size(MESSAGE_BYTES_MAX);
        let request = BlocksRequest { from_height: end.height + 1 };
        let refused = |status: tonic::Status| ledger_api::from_status(&offer.member.address, &status);
        let mut stream = in_time(client.blocks(request)).await?.map_err(refused)?.into_inner();
        let mut told = Instant::now();
        // Beyond what the others have, nobody confirms.
        let limit = confirming.iter().map(|other| other.chain.height).max().unwrap_or(u64::MAX);
        while let Some(batch) = next_batch(&mut stream, end, limit, offer).await? {
            if self.is_stopping() {
                return Ok(());
            }
            if !confirming.is_empty() {
                confirm(&batch.end, &confirming).await?;
            }
            end = batch.end;
            let shared = Arc::clone(&self.shared);
            let taken = tokio::task::spawn_blocking(move || take_in(&shared, batch)).await;
            taken.map_err(|_| Rejection::new(Code::Internal, "the execution of fetched blocks panicked"))??;
            if told.elapsed() > PROGRESS_PERIOD {
                told = Instant::now();
                tracing::info!(height = end.height, of = until, "fetching blocks");
            }
        }
        Ok(())
    }
}

/// No node of another organisation can be asked.
struct Unconfirmed;

/// A fault of this node, not of the one that gave the blocks.
pub(super) fn is_own(fault: &Rejection) -> bool {
    matches!(fault.code, Code::Corrupt | Code::DiskFailed | Code::DiskFull | Code::Internal | Code::Diverged)
}

pub(super) async fn in_time<T>(answer: impl Future<Output = T>) -> Result<T, Rejection> {
    tokio::time::timeout(SILENCE_MAX, answer)
        .await
        .map_err(|_| Rejection::new(Code::Timeout, format!("no answer within {SILENCE_MAX:?}")))
}

/// The next blocks of a stream, up to a height; none at its end.
async fn next_batch(
    stream: &mut Streaming<BlockEntries>,
    mut end: End,
    limit: u64,
    offer: &Offer,
) -> Result<Option<Batch>, Rejection> {
    let (mut entries, mut hashes, mut bytes) = (Vec::new(), Vec::new(), 0);
    while bytes < BATCH_BYTES && entries.len() < BATCH_BLOCKS_MAX && end.height < limit {
        let message = in_time(stream.message()).await?;
        let message = message.map_err(|status| ledger_api::from_status(&offer.member.address, &status))?;
        let Some(message) = message else { break };
        for block in message.entries.into_iter().take_while(|block| block.height <= limit) {
            let entry = follows(end, block)?;
            let header = Header::following(end.hash, end.time, &entry);
            end = End { height: entry.index, term: entry.term, time: header.time, hash: header.hash() };
            bytes += entry.data.len();
            entries.push(entry);
            hashes.push(end.hash);
        }
    }
    Ok((!entries.is_empty()).then_some(Batch { entries, hashes, end }))
}

/// The entry, if it can be the next one.
fn follows(end: End, block: BlockEntry) -> Result<Entry, Rejection> {
    let BlockEntry { height, term, kind, data } = block;
    let kind = u8::try_from(kind).ok().and_then(EntryKind::from_code);
    match kind {
        Some(kind) if height == end.height + 1 && term >= end.term => Ok(Entry { index: height, term, kind, data }),
        _ => Err(Rejection::new(Code::ChainInvalid, "a fetched block does not follow the one before it")
            .found(format!("height {height} of term {term}"))
            .wanted(format!("height {} of term {} or later", end.height + 1, end.term))),
    }
}

/// Asks the others for the block hash at the end of a batch; one that has it must agree.
async fn confirm(end: &End, confirming: &[Offer]) -> Result<(), Rejection> {
    for offer in confirming {
        match block_hash(offer.channel.clone(), end.height).await {
            Ok(Some(hash)) if hash == end.hash => return Ok(()),
            Ok(Some(hash)) => {
                return Err(Rejection::new(
                    Code::ChainInvalid,
                    format!("{} has another block at height {}", offer.member.full_name(), end.height),
                )
                .found(format!("block hash {hash}"))
                .wanted(format!("block hash {}, which follows from the fetched blocks", end.hash)));
            }
            Ok(None) => {}
            Err(reason) => {
                tracing::debug!(peer = %offer.member.full_name(), %reason, "the peer does not confirm the blocks")
            }
        }
    }
    Err(Rejection::new(Code::Behind, format!("no other organisation's node has block {} yet", end.height))
        .next("the rest comes by replication"))
}

async fn block_hash(channel: Channel, height: u64) -> Result<Option<Hash>, Rejection> {
    let answer = in_time(PeerClient::new(channel).digest(DigestRequest { height })).await?;
    let answer = answer.map_err(|status| Rejection::new(Code::Unreachable, status.message().to_owned()))?.into_inner();
    Ok(Hash::from_slice(&answer.block_hash))
}

/// Stores blocks and executes them.
fn take_in(shared: &crate::orderer::Shared, batch: Batch) -> Result<(), Rejection> {
    let Batch { entries, hashes, end } = batch;
    store(&shared.store, &entries, end)?;
    for (entry, hash) in entries.iter().zip(hashes) {
        let outcome = shared.executor.execute(entry)?;
        if outcome.hash != hash {
            return Err(Rejection::new(Code::Internal, format!("block {} has two hashes", entry.index))
                .found(outcome.hash.to_string())
                .wanted(hash.to_string()));
        }
    }
    if shared.ledger.pending_bytes() > PENDING_BYTES_MAX {
        shared.ledger.flush(Some(&shared.snapshots))?;
    }
    Ok(())
}

/// Makes blocks durable as committed. Entries that the log has already stay. Entries of the same index and term are the
/// same (Raft §5.3, log matching), and the ones after them may have been acknowledged.
fn store(store: &BlockStore, entries: &[Entry], end: End) -> Result<(), Rejection> {
    let known = entries.iter().take_while(|entry| store.term(entry.index) == Some(entry.term)).count();
    let HardState { term, vote, .. } = store.hard_state();
    let newer = end.term > term;
    // A vote belongs to its term.
    let hard_state = HardState { term: term.max(end.term), vote: if newer { 0 } else { vote }, commit: end.height };
    store.append(entries.get(known..).unwrap_or_default(), Some(&hard_state))?;
    store.flush()?;
    store.set_committed(end.height);
    Ok(())
}

/// An entry as it travels.
pub(super) fn to_wire(entry: Entry) -> BlockEntry {
    let Entry { index, term, kind, data } = entry;
    BlockEntry { height: index, term, kind: u32::from(kind.code()), data }
}
