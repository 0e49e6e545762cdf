//! Streams of blocks, and block hashes that confirm them.

use crate::peers::question::Contact;
use ledger::block::PAYLOAD_BYTES_MAX;
use ledger_api::v1::peer_client::PeerClient;
use ledger_api::v1::{BlockEntries, BlockEntry, BlocksRequest, ChainRequest, DigestRequest};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_replica::catch_up::SILENCE_MAX;
use ledger_storage::entry::{Entry, EntryKind};
use std::time::Duration;
use tonic::Streaming;

/// Most bytes of one message: a block of the largest size, and what is around it.
const MESSAGE_BYTES_MAX: usize = PAYLOAD_BYTES_MAX + 2 * 1024 * 1024;

/// Opens a stream of blocks from a height on.
pub(crate) async fn open(peer: &Contact, from_height: u64) -> Result<Streaming<BlockEntries>, Rejection> {
    let mut client = PeerClient::new(peer.channel.clone()).max_decoding_message_size(MESSAGE_BYTES_MAX);
    let answer = in_time(client.blocks(BlocksRequest { from_height })).await?;
    Ok(answer.map_err(|status| ledger_api::from_status(&peer.address, &status))?.into_inner())
}

/// The blocks of the next message of a stream, which comes from that address; none at its end.
pub(crate) async fn next(
    stream: &mut Option<(Streaming<BlockEntries>, String)>,
) -> Result<Option<Vec<Entry>>, Rejection> {
    let Some((stream, address)) = stream else { return Ok(None) };
    let message = in_time(stream.message()).await?;
    let message = message.map_err(|status| ledger_api::from_status(address, &status))?;
    message.map(|message| message.entries.into_iter().map(from_wire).collect()).transpose()
}

/// The block hash of a node at a height, if it has that block.
pub(crate) async fn block_hash(peer: &Contact, height: u64) -> Result<Option<Hash>, Rejection> {
    let answer = in_time(PeerClient::new(peer.channel.clone()).digest(DigestRequest { height })).await?;
    let answer = answer.map_err(|status| Rejection::new(Code::Unreachable, status.message().to_owned()))?.into_inner();
    Ok(Hash::from_slice(&answer.block_hash))
}

/// The newest committed block of a node.
pub(crate) async fn tip(peer: &Contact) -> Result<u64, Rejection> {
    let answer = in_time(PeerClient::new(peer.channel.clone()).chain(ChainRequest::default())).await?;
    let answer = answer.map_err(|status| Rejection::new(Code::Unreachable, status.message().to_owned()))?;
    Ok(answer.into_inner().height)
}

/// The answer of another node, unless it is silent for too long.
pub(super) async fn in_time<T>(answer: impl Future<Output = T>) -> Result<T, Rejection> {
    let silence = Duration::from_micros(SILENCE_MAX);
    tokio::time::timeout(silence, answer)
        .await
        .map_err(|_| Rejection::new(Code::Timeout, format!("no answer within {silence:?}")).next("ask another node"))
}

/// An entry as it travels.
pub(super) fn to_wire(entry: Entry) -> BlockEntry {
    let Entry { index, term, kind, data } = entry;
    BlockEntry { height: index, term, kind: u32::from(kind.code()), data }
}

fn from_wire(block: BlockEntry) -> Result<Entry, Rejection> {
    let BlockEntry { height, term, kind, data } = block;
    match u8::try_from(kind).ok().and_then(EntryKind::from_code) {
        Some(kind) => Ok(Entry { index: height, term, kind, data }),
        None => Err(Rejection::new(Code::ChainInvalid, "a fetched block is of an unknown kind")
            .found(format!("kind {kind} at height {height}"))),
    }
}
