//! The data directory of a node, and the work on its disk.
//!
//! | module | content |
//! |---|---|
//! | `files` | names of files in the data directory, and marks that keep a node from starting |
//! | `stores` | opening blocks, results and world state; rebuilding the latter |
//! | `log` | durable writes of blocks, on a disk that may be full |
//! | `blocks` | executed blocks for readers |
//! | `space` | how full the disk is, what is still accepted, and the reserve |
//! | `housekeeping`, `retention`, `scrub` | threads for work on the disk; dropping old blocks; reading old blocks to find damage |

pub(crate) mod blocks;
pub(crate) mod files;
pub(crate) mod housekeeping;
pub(crate) mod log;
pub(crate) mod retention;
pub(crate) mod scrub;
pub(crate) mod space;
pub(crate) mod stores;

use crate::process::config::Config;
use crate::process::failure::{FailureHandle, thread_error};
use crate::process::meters::Meters;
use blocks::Blocks;
use bytes::Bytes;
use housekeeping::{Bells, Housekeeping};
use ledger::network::Genesis;
use ledger::{Ledger, Registry};
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::retention::Retention;
use ledger_storage::snapshot::Snapshots;
use log::Log;
use retention::Pruner;
use scrub::Scrub;
use space::{Space, give_up_reserve};
use std::path::PathBuf;
use std::sync::Arc;
use stores::Stores;

/// The stores of a running node.
pub(crate) struct Storage {
    /// The data directory.
    pub data: PathBuf,
    /// The beginning of the network.
    pub genesis: Genesis,
    /// The same, byte for byte.
    pub document: Bytes,
    /// The ledger; everything known to be committed is executed.
    pub ledger: Arc<Ledger>,
    /// The log of blocks.
    pub log: Log,
    /// The world state at some heights.
    pub snapshots: Arc<Snapshots>,
    /// Executed blocks, for readers.
    pub blocks: Arc<Blocks>,
    /// The room that the disk still has.
    pub space: Arc<Space>,
    /// Wake housekeeping when there is work for it.
    pub bells: Arc<Bells>,
    retention: Retention,
    archive: Option<PathBuf>,
}

impl Storage {
    /// Opens the stores of a data directory, as [`Stores::open`], and measures its disk.
    ///
    /// # Errors
    /// As [`Stores::open`].
    pub(crate) fn open(
        config: &Config,
        document: Vec<u8>,
        registry: Registry,
        meters: &Meters,
    ) -> Result<Arc<Self>, Rejection> {
        let open = || Stores::open(config, &document, registry.clone());
        let opened = match open() {
            Err(full) if full.code == Code::DiskFull && give_up_reserve(&config.data) => {
                tracing::warn!(data = %config.data.display(), "disk full: releasing the reserve to open the stores");
                open()
            }
            opened => opened,
        };
        let Stores { genesis, ledger, store, snapshots } = opened?;
        let space = Arc::new(Space::open(&config.data));
        Ok(Arc::new(Self {
            data: config.data.clone(),
            genesis,
            document: document.into(),
            blocks: Arc::new(Blocks::new(Arc::clone(&ledger), Arc::clone(&store))),
            log: Log { store, space: Arc::clone(&space), flushed: meters.flush.clone() },
            ledger,
            snapshots,
            space,
            bells: Arc::default(),
            retention: config.storage.retention,
            archive: Some(config.storage.archive.clone()).filter(|path| !path.as_os_str().is_empty()),
        }))
    }

    /// Starts the threads that work beside the commands. `sweep` ends what has waited too long, now and then.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn housekeeping(&self, sweep: impl FnMut() + Send + 'static) -> Result<Housekeeping, Rejection> {
        let pruner = Pruner {
            ledger: Arc::clone(&self.ledger),
            store: Arc::clone(&self.log.store),
            snapshots: Arc::clone(&self.snapshots),
            space: Arc::clone(&self.space),
            retention: self.retention,
            archive: self.archive.clone(),
            data: self.data.clone(),
        };
        let housekeeping = Housekeeping::start(pruner, &self.space, sweep, Arc::clone(&self.bells));
        housekeeping.map_err(|error| thread_error(&error))
    }

    /// Starts to read the finished part of the log for damage, which ends the node.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn scrub(&self, failure: FailureHandle) -> Result<Scrub, Rejection> {
        Scrub::start(Arc::clone(&self.log.store), failure).map_err(|error| thread_error(&error))
    }
}

#[cfg(test)]
pub(crate) mod tests;
