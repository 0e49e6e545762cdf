//! Opening what a node keeps: blocks, which are the truth, and the world state, which is rebuilt if there is any doubt.

use crate::process::config::Config;
use crate::process::random;
use crate::storage::files::{CERTIFICATES_DIRECTORY, DIVERGED_FILE, NEWEST_PROOF_FILE};
use ledger::network::Genesis;
use ledger::{Ledger, Registry};
use ledger_base::durable::read;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Proof;
use ledger_light::proof::PROOF_BYTES_MAX;
use ledger_replica::opening::{Kept, Opening};
use ledger_storage::block_store::{BlockStore, Options, StoreError};
use ledger_storage::disk::RealDisk;
use ledger_storage::layout::{
    AUDIT_DIRECTORY, BLOCKS_DIRECTORY, RESULTS_DIRECTORY, SNAPSHOTS_DIRECTORY, STATE_DIRECTORY,
};
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{SledStore, Store};
use std::path::Path;
use std::sync::Arc;

/// Blocks of the log that stay in memory for followers that lack a few; more are in the cache of the operating system.
const LOG_CACHE_BYTES: usize = 2 * 1024 * 1024;

/// The opened stores.
pub(crate) struct Stores {
    /// The beginning of the network.
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
        let opening = Opening {
            genesis: genesis_bytes,
            registry: &registry,
            store: &store,
            snapshots: &snapshots,
            diverged,
            certified: certified(&config.data),
        };
        let ledger = opening.open(&mut Directories { data: &config.data, network })?;
        if diverged && let Err(error) = std::fs::remove_file(&mark) {
            tracing::warn!(%error, mark = %mark.display(), "cannot remove the mark; the next start rebuilds the world \
                                                            state again");
        }
        Ok(Self { genesis, ledger: Arc::new(ledger), store, snapshots })
    }
}

/// Height and hash of the newest certified block whose proof is kept. One that cannot be read is as good as none.
fn certified(data: &Path) -> Option<(u64, Hash)> {
    let path = data.join(CERTIFICATES_DIRECTORY).join(NEWEST_PROOF_FILE);
    let proof = path.exists().then(|| Proof::from_bytes(&read(&path, PROOF_BYTES_MAX).ok()?).ok())??;
    Some((proof.certificate.statement.height, proof.certificate.statement.block))
}

fn open_directory(directory: &Path) -> Result<RealDisk, Rejection> {
    RealDisk::open(directory).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot open {}: {error}", directory.display()))
            .next("check that no other node uses this directory, and who may write to it")
    })
}

/// Opens the log of a data directory.
///
/// # Errors
/// As [`Stores::open`].
pub(crate) fn open_blocks(config: &Config, network: Hash) -> Result<BlockStore, Rejection> {
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
        let directory = config.data.join(BLOCKS_DIRECTORY);
        if damaged { refused.prefix(format_args!("{}/", directory.display())) } else { refused }
    })?;
    if let Some(torn) = &recovery.torn {
        tracing::warn!(file = %torn.file, offset = torn.offset, bytes = torn.bytes, "removed a torn write that was \
                                                                                     never acknowledged");
    }
    for file in &recovery.ignored {
        tracing::warn!(%file, "file does not belong to the block store; ignoring it");
    }
    Ok(store)
}

/// World state and results, in the data directory.
struct Directories<'a> {
    data: &'a Path,
    network: Hash,
}

impl Kept for Directories<'_> {
    fn state(&mut self) -> Result<Box<dyn Store>, Rejection> {
        Ok(Box::new(SledStore::open(&self.data.join(STATE_DIRECTORY))?))
    }

    fn results(&mut self, blocks: &Arc<BlockStore>) -> Result<ResultStore, Rejection> {
        let results = open_directory(&self.data.join(RESULTS_DIRECTORY))?;
        Ok(ResultStore::open(Arc::new(results), self.network)?.beside(Arc::clone(blocks)))
    }

    fn set_aside(&mut self) -> Result<(), Rejection> {
        set_aside(&self.data.join(STATE_DIRECTORY))?;
        set_aside(&self.data.join(RESULTS_DIRECTORY))?;
        // It may hold what was computed wrongly.
        set_aside(&self.data.join(AUDIT_DIRECTORY))
    }
}

/// Moves a directory out of the way; the one that was moved before is deleted.
fn set_aside(directory: &Path) -> Result<(), Rejection> {
    let aside = directory.with_extension("damaged");
    let moved = match std::fs::remove_dir_all(&aside) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ if !directory.exists() => Ok(()),
        _ => std::fs::rename(directory, &aside),
    };
    moved.map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot move {} aside: {error}", directory.display()))
            .next("delete it manually; it is rebuilt from the blocks")
    })?;
    tracing::info!(aside = %aside.display(), "previous directory moved aside");
    Ok(())
}
