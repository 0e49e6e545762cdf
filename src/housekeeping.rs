//! What a node does beside its work, on two threads of their own. One zeroes the log ahead, answers those who have waited
//! too long and watches the disk. The other stores results and world state and makes snapshots, which may take long.

use crate::gateway::NodeView;
use crate::retention::Pruner;
use ledger::Code;
use ledger::block_store::BlockStore;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Between two rounds.
const PERIOD: Duration = Duration::from_millis(50);
/// World state is stored this often if it changed: the work that a crash leaves to be done again. Commands that meet it on
/// the disk wait longer.
const FLUSH_PERIOD: Duration = Duration::from_secs(2);
/// Results and world state in memory that are stored at once.
const PENDING_BYTES_MAX: usize = 4 * 1024 * 1024;
/// Old blocks are looked at this often.
const PRUNE_PERIOD: Duration = Duration::from_secs(10);
/// Waiters are looked at this often.
const SWEEP_PERIOD: Duration = Duration::from_secs(1);
/// With less space than this left, nothing more is accepted: what was accepted must still fit.
const FREE_BYTES_MIN: u64 = 16 * 1024 * 1024;

/// The threads.
pub(crate) struct Housekeeping {
    stop: Vec<Sender<()>>,
    threads: Vec<JoinHandle<()>>,
}

impl Housekeeping {
    /// Starts them.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(node: Arc<NodeView>, pruner: Pruner) -> io::Result<Self> {
        let (store, data) = (Arc::clone(&pruner.store), pruner.data.clone());
        let mut keeper = Keeper { node: Arc::clone(&node), pruner, flushed: Instant::now(), pruned: Instant::now() };
        let (stop_storing, stopped) = mpsc::channel();
        let storing = std::thread::Builder::new().name("store".into()).spawn(move || {
            while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                keeper.round();
            }
            keeper.flush();
        })?;
        let (stop_rounds, stopped) = mpsc::channel();
        let rounds = std::thread::Builder::new().name("housekeeping".into()).spawn(move || {
            let mut rounds = Rounds { node, store, data, swept: None };
            while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                rounds.round();
            }
        })?;
        Ok(Self { stop: vec![stop_rounds, stop_storing], threads: vec![rounds, storing] })
    }

    /// Ends them; the world state is stored a last time.
    pub(crate) fn stop(self) {
        drop(self.stop);
        for thread in self.threads {
            if thread.join().is_err() {
                tracing::error!("a thread of housekeeping had panicked");
            }
        }
    }
}

/// Stores results and world state.
struct Keeper {
    node: Arc<NodeView>,
    pruner: Pruner,
    flushed: Instant,
    pruned: Instant,
}

impl Keeper {
    fn round(&mut self) {
        let pending = self.node.ledger.pending_bytes();
        if pending > PENDING_BYTES_MAX || (pending > 0 && self.flushed.elapsed() >= FLUSH_PERIOD) {
            self.flush();
        }
        if self.pruned.elapsed() >= PRUNE_PERIOD {
            self.pruned = Instant::now();
            if let Err(fault) = self.pruner.prune() {
                tracing::error!(%fault, "cannot drop old blocks");
            }
        }
    }

    fn flush(&mut self) {
        self.flushed = Instant::now();
        if self.node.disk_full.load(Ordering::Relaxed) {
            // The blocks have it; what the log still has to write goes first.
            return;
        }
        let durable = self.pruner.store.durable_index();
        match self.node.ledger.flush_up_to(durable, Some(&self.pruner.snapshots)) {
            Ok(()) => {}
            Err(fault) if fault.code == Code::DiskFull => set_full(&self.node, true),
            // Nothing is lost: the blocks have it, and the next start rebuilds what is missing.
            Err(fault) => tracing::error!(%fault, "cannot store the world state"),
        }
    }
}

struct Rounds {
    node: Arc<NodeView>,
    store: Arc<BlockStore>,
    data: PathBuf,
    swept: Option<Instant>,
}

impl Rounds {
    fn round(&mut self) {
        self.watch_disk();
        if let Err(error) = self.store.prepare() {
            tracing::debug!(%error, "cannot zero the log ahead");
        }
        if self.swept.is_none_or(|swept| swept.elapsed() >= SWEEP_PERIOD) {
            self.swept = Some(Instant::now());
            self.node.waiters.sweep();
        }
    }

    fn watch_disk(&self) {
        match free_bytes(&self.data) {
            Ok(free) => set_full(&self.node, free < FREE_BYTES_MIN),
            Err(error) => tracing::debug!(%error, "cannot ask how much space is left"),
        }
    }
}

fn set_full(node: &NodeView, full: bool) {
    if node.disk_full.swap(full, Ordering::Relaxed) != full {
        match full {
            true => tracing::error!("the disk is almost full; nothing more is accepted"),
            false => tracing::info!("there is space on the disk again"),
        }
    }
}

fn free_bytes(path: &Path) -> io::Result<u64> {
    let found = rustix::fs::statvfs(path)?;
    Ok(found.f_bavail.saturating_mul(found.f_frsize))
}
