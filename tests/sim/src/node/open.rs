//! Opening what a node has, as `src/stores.rs` does: blocks, then the world state, which is rebuilt if there is any
//! doubt about it.

use super::Node;
use ledger::{Chaincode, Ledger, Registry};
use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};
use ledger_storage::block_store::{BlockStore, Options, StoreError};
use ledger_storage::entry::Entry;
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{State, Store};
use std::sync::Arc;

/// Bytes of blocks read at once.
const REPLAY_BYTES: usize = 4 << 20;

/// What a start found.
pub struct Opened {
    /// The world state.
    pub state: Arc<State>,
    /// The world state at some heights.
    pub snapshots: Arc<Snapshots>,
    /// The ledger at its savepoint.
    pub ledger: Ledger,
    /// Blocks that are committed and not yet executed.
    pub replay: Vec<Entry>,
}

/// Opens the world state of a node whose log is open, and says what of the log it has not executed.
///
/// # Errors
/// What the node would say, and end.
pub fn open(
    node: &mut Node,
    store: &Arc<BlockStore>,
    (genesis, network): (&[u8], Hash),
    abac: &Arc<dyn Chaincode>,
) -> Result<Opened, Rejection> {
    let snapshots = Arc::new(Snapshots::open(Arc::new(node.snapshots.clone()), network)?);
    let (state, ledger) = match open_ledger(node, (genesis, network), abac, store, &snapshots) {
        Err(fault) if fault.code == Code::Corrupt => {
            node.forget_state(node.start);
            open_ledger(node, (genesis, network), abac, store, &snapshots)?
        }
        other => other?,
    };
    let (mut next, committed) = (ledger.tip().height + 1, store.hard_state().commit);
    let mut replay = Vec::new();
    while next <= committed {
        let entries = store.entries(next..committed + 1, REPLAY_BYTES)?;
        next += entries.len() as u64;
        replay.extend(entries);
    }
    Ok(Opened { state, snapshots, ledger, replay })
}

/// Opens the log of a node whose process is not running.
///
/// # Errors
/// What the node would say, and end.
pub fn open_blocks(node: &Node, network: Hash, segment_bytes: u64, salt: u64) -> Result<BlockStore, StoreError> {
    let mut segment = salt;
    let mut options = Options::new(network.0, move || {
        segment = segment.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        segment
    });
    options.segment_bytes = segment_bytes;
    // Small, so that old blocks are really read from the disk.
    options.cache_bytes = 64 * 1024;
    Ok(BlockStore::open(Arc::new(node.disk.clone()), options)?.0)
}

fn open_ledger(
    node: &Node,
    (genesis, network): (&[u8], Hash),
    abac: &Arc<dyn Chaincode>,
    store: &Arc<BlockStore>,
    snapshots: &Snapshots,
) -> Result<(Arc<State>, Ledger), Rejection> {
    let results = ResultStore::open(Arc::new(node.results.clone()), network)?;
    // Who drops blocks here drops them sooner than a node may (`KEPT_MIN_US`), and asks for their results afterwards.
    let results = if node.keep.is_none() { results.beside(Arc::clone(store)) } else { results };
    if store.first_index() > 1 && Store::range(&node.shelf, b"", None, 1)?.is_empty() {
        let usable = snapshots.newest().filter(|snapshot| snapshot.manifest().height + 1 >= store.first_index());
        let missing =
            || Rejection::new(Code::ChainInvalid, "the world state cannot be rebuilt: older blocks were dropped");
        usable.ok_or_else(missing)?.fill(&node.shelf, &results)?;
    }
    let state = Arc::new(State::open(Box::new(node.shelf.clone()))?);
    let mut registry = Registry::new();
    registry.install(Arc::clone(abac))?;
    let ledger = Ledger::open(genesis, registry, Arc::clone(&state), Arc::new(results))?;
    let reached = ledger.tip();
    if reached.height > store.last_index() {
        return Err(Rejection::new(Code::ChainInvalid, "the log has lost committed blocks"));
    }
    if reached.height > 0 && store.term(reached.height) != Some(reached.term) {
        return Err(Rejection::new(Code::Corrupt, "the world state does not belong to these blocks"));
    }
    Ok((state, ledger))
}
