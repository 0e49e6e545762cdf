//! Opening what a node keeps: blocks, which are the truth, and the world state, which is rebuilt if there is any doubt.

use crate::config::Config;
use crate::join::REJOIN;
use crate::random;
use crate::witness::DIVERGED_FILE;
use ledger::network::Genesis;
use ledger::{Ledger, Registry};
use ledger_hash::Hash;
use ledger_rejection::{Code, Rejection};
use ledger_storage::block_store::{BlockStore, Options, StoreError};
use ledger_storage::disk::RealDisk;
use ledger_storage::layout::{BLOCKS_DIRECTORY, RESULTS_DIRECTORY, SNAPSHOTS_DIRECTORY, STATE_DIRECTORY};
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{SledStore, State, Store};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Entries read at once while blocks are executed again.
const REPLAY_BYTES: usize = 4 * 1024 * 1024;
/// Blocks of the log that stay in memory for followers that lack a few; more are in the cache of the operating system.
const LOG_CACHE_BYTES: usize = 2 * 1024 * 1024;
/// World state in memory that is moved to the store while blocks are executed again.
const DIRTY_BYTES_MAX: usize = 16 * 1024 * 1024;

/// The opened stores.
#[derive(Clone)]
pub(crate) struct Stores {
    /// What the network began with.
    pub genesis: Genesis,
    /// The ledger; everything known to be committed is executed.
    pub ledger: Arc<Ledger>,
    /// The log.
    pub store: Arc<BlockStore>,
    /// The world state at some heights.
    pub snapshots: Arc<Snapshots>,
}

impl Stores {
    /// Opens the stores of a data directory and executes the blocks that the world state has not seen.
    ///
    /// # Errors
    /// Damage that cannot be repaired, with file and byte; a directory in use; a full disk.
    pub(crate) fn open(config: &Config, genesis_bytes: &[u8], registry: Registry) -> Result<Self, Rejection> {
        let (genesis, network) = Genesis::from_bytes(genesis_bytes)?;
        let store = Arc::new(open_blocks(config, network)?);
        let snapshots = open_directory(&config.data.join(SNAPSHOTS_DIRECTORY))?;
        let snapshots = Arc::new(Snapshots::open(Arc::new(snapshots), network)?);
        let mark = config.data.join(DIVERGED_FILE);
        let diverged = mark.exists();
        if diverged {
            set_aside(&config.data.join(STATE_DIRECTORY))?;
            set_aside(&config.data.join(RESULTS_DIRECTORY))?;
            tracing::warn!(
                "world state and results differed from those of other nodes; the node rebuilds them from the blocks"
            );
        }
        let open = || open_ledger(&config.data, genesis_bytes, &registry, &store, &snapshots);
        let ledger = match open() {
            Ok(ledger) => ledger,
            Err(fault) if fault.code == Code::Corrupt => {
                let aside = set_aside(&config.data.join(STATE_DIRECTORY))?;
                set_aside(&config.data.join(RESULTS_DIRECTORY))?;
                tracing::warn!(reason = %fault, aside = %aside.display(), "world state and results are set aside and rebuilt from the blocks");
                open()?
            }
            Err(fault) => return Err(fault),
        };
        if diverged && let Err(error) = std::fs::remove_file(&mark) {
            tracing::warn!(%error, mark = %mark.display(), "cannot remove the mark; the next start will rebuild the world state again");
        }
        Ok(Self { genesis, ledger: Arc::new(ledger), store, snapshots })
    }
}

fn open_directory(directory: &Path) -> Result<RealDisk, Rejection> {
    RealDisk::open(directory).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot open {}: {error}", directory.display()))
            .next("check that no other node uses this directory, and which users may write it")
    })
}

fn open_blocks(config: &Config, network: Hash) -> Result<BlockStore, Rejection> {
    let disk = open_directory(&config.data.join(BLOCKS_DIRECTORY))?;
    // One number from the system; each segment's salt follows from it, unknown to clients.
    let (seed, mut segment) = (random::number()?, 0u64);
    let mut options = Options::new(network.0, move || {
        segment += 1;
        let Hash(salt) = Hash::of(&[b"segment salt", &seed.to_be_bytes(), &segment.to_be_bytes()]);
        salt.iter().take(8).fold(0, |number, byte| number << 8 | u64::from(*byte))
    });
    options.segment_bytes = config.storage.segment_mib << 20;
    options.cache_bytes = LOG_CACHE_BYTES;
    let (store, recovery) = BlockStore::open(Arc::new(disk), options).map_err(|error| {
        let damaged = matches!(error, StoreError::Corrupt { .. });
        let refused = Rejection::from(error);
        // Which begins with the name of the file.
        let message = format!("{}/{}", config.data.join(BLOCKS_DIRECTORY).display(), refused.message);
        if damaged { Rejection { message, ..refused } } else { refused }
    })?;
    if let Some(torn) = &recovery.torn {
        tracing::warn!(file = %torn.file, offset = torn.offset, bytes = torn.bytes, "removed a torn write that was never acknowledged");
    }
    for file in &recovery.ignored {
        tracing::warn!(%file, "this file does not belong to the block store; it is left alone");
    }
    Ok(store)
}

fn open_ledger(
    data: &Path,
    genesis: &[u8],
    registry: &Registry,
    store: &Arc<BlockStore>,
    snapshots: &Snapshots,
) -> Result<Ledger, Rejection> {
    let (_, network) = Genesis::from_bytes(genesis)?;
    let kept = SledStore::open(&data.join(STATE_DIRECTORY))?;
    let results = ResultStore::open(Arc::new(open_directory(&data.join(RESULTS_DIRECTORY))?), network)?;
    let results = results.beside(Arc::clone(store));
    if store.first_index() > 1 && kept.range(b"", None, 1)?.is_empty() {
        fill(&kept, &results, store, snapshots)?;
    }
    let state = Arc::new(State::open(Box::new(kept))?);
    let ledger = Ledger::open(genesis, registry.clone(), state, Arc::new(results))?;
    let reached = ledger.tip();
    if reached.height > store.last_index() {
        // Not a doubt about the state: the log has lost blocks that were promised. Rebuilding would hide it.
        return Err(Rejection::new(Code::ChainInvalid, "the log has lost committed blocks")
            .found(format!(
                "blocks up to height {}, and a world state that has executed {}",
                store.last_index(),
                reached.height
            ))
            .wanted(format!("blocks up to height {}", reached.height))
            .next(format!("{REJOIN}: it comes back as a new node and fetches them from the others; without others, restore blocks/ from a copy")));
    }
    if reached.height + 1 < store.first_index() {
        return Err(Rejection::new(Code::Corrupt, "the world state ends before the first block that is kept")
            .found(format!("a world state of height {}, and blocks from {} on", reached.height, store.first_index())));
    }
    if reached.height > 0 && store.term(reached.height) != Some(reached.term) {
        return Err(Rejection::new(Code::Corrupt, "the world state does not belong to these blocks")
            .found(format!("height {} of term {}", reached.height, reached.term))
            .wanted(format!("term {:?}", store.term(reached.height))));
    }
    let committed = store.hard_state().commit;
    let mut next = reached.height + 1;
    while next <= committed {
        for entry in store.entries(next..committed + 1, REPLAY_BYTES)? {
            ledger.apply(&entry)?;
            next += 1;
        }
        if ledger.pending_bytes() > DIRTY_BYTES_MAX {
            ledger.flush(Some(snapshots))?;
            tracing::info!(height = next - 1, of = committed, "executing blocks again");
        }
    }
    Ok(ledger)
}

/// The blocks begin above 1: execution begins with the newest snapshot.
fn fill(kept: &SledStore, results: &ResultStore, store: &BlockStore, snapshots: &Snapshots) -> Result<(), Rejection> {
    let first = store.first_index();
    let usable = snapshots.newest().filter(|snapshot| snapshot.manifest().height + 1 >= first);
    let Some(snapshot) = usable else {
        return Err(Rejection::new(Code::ChainInvalid, "the world state cannot be rebuilt: older blocks were dropped")
            .found(format!("blocks from {first} on, and no snapshot of height {} or above", first - 1))
            .next(format!("{REJOIN}: it comes back as a new node and fetches everything again")));
    };
    tracing::info!(height = snapshot.manifest().height, content = %snapshot.content(), "the world state begins with a snapshot");
    snapshot.fill(kept, results)
}

/// Moves a directory out of the way; what was moved before is deleted.
fn set_aside(directory: &Path) -> Result<PathBuf, Rejection> {
    let aside = directory.with_extension("damaged");
    let moved = match std::fs::remove_dir_all(&aside) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ if !directory.exists() => Ok(()),
        _ => std::fs::rename(directory, &aside),
    };
    moved.map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot move {} aside: {error}", directory.display()))
            .next("delete it by hand; it is rebuilt from the blocks")
    })?;
    Ok(aside)
}
