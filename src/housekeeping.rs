//! What a node does beside its work, on two threads of their own. One zeroes the log ahead, answers those who have waited
//! too long and watches the disk. The other stores results and world state, makes snapshots, which may take long, and
//! drops old blocks.

use crate::gateway::NodeView;
use ledger::block_store::BlockStore;
use ledger::retention::{Kept, Retention};
use ledger::snapshot::Snapshots;
use ledger::{Code, Ledger, Rejection};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Between two rounds.
const PERIOD: Duration = Duration::from_millis(50);
/// World state is stored this often if it changed: the work that a crash leaves to be done again.
const FLUSH_PERIOD: Duration = Duration::from_millis(500);
/// Results and world state in memory that are stored at once.
const PENDING_BYTES_MAX: usize = 4 * 1024 * 1024;
/// Waiters are looked at this often.
const SWEEP_PERIOD: Duration = Duration::from_secs(1);
/// Old blocks are dropped this often.
const PRUNE_PERIOD: Duration = Duration::from_secs(60);
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
    pub(crate) fn start(
        node: Arc<NodeView>,
        store: Arc<BlockStore>,
        snapshots: Arc<Snapshots>,
        data: PathBuf,
        retention: Retention,
    ) -> io::Result<Self> {
        let mut keeper = Keeper {
            node: Arc::clone(&node),
            store: Arc::clone(&store),
            snapshots,
            retention,
            flushed: Instant::now(),
            pruned: None,
        };
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

/// Stores results and world state, and drops old blocks.
struct Keeper {
    node: Arc<NodeView>,
    store: Arc<BlockStore>,
    snapshots: Arc<Snapshots>,
    retention: Retention,
    flushed: Instant,
    pruned: Option<Instant>,
}

impl Keeper {
    fn round(&mut self) {
        let pending = self.node.ledger.pending_bytes();
        if pending > PENDING_BYTES_MAX || (pending > 0 && self.flushed.elapsed() >= FLUSH_PERIOD) {
            self.flush();
        }
        if self.pruned.is_none_or(|pruned| pruned.elapsed() >= PRUNE_PERIOD) {
            self.pruned = Some(Instant::now());
            if let Err(fault) = prune(&self.retention, &self.node.ledger, &self.store, &self.snapshots) {
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
        match self.node.ledger.flush(Some(&self.snapshots)) {
            Ok(()) => {}
            Err(fault) if fault.code == Code::DiskFull => set_full(&self.node, true),
            // Nothing is lost: the blocks have it, and the next start rebuilds what is missing.
            Err(fault) => tracing::error!(%fault, "cannot store the world state"),
        }
    }
}

/// Drops the blocks that are not to be kept any longer, and their results.
fn prune(retention: &Retention, ledger: &Ledger, store: &BlockStore, snapshots: &Snapshots) -> Result<(), Rejection> {
    if *retention == Retention::Forever {
        return Ok(());
    }
    let finished = store.finished();
    let oldest_snapshot = snapshots.oldest().map(|snapshot| snapshot.manifest().height);
    let time_of = |height| ledger.result(height).ok().flatten().map(|result| result.time);
    let keep_from =
        retention.keep_from(&Kept { finished: &finished, oldest_snapshot, time: ledger.tip().time, time_of: &time_of });
    let before = store.first_index();
    let first = if keep_from > before { store.prune(keep_from)? } else { before };
    if first > before {
        tracing::info!(first, "dropped the blocks before this one");
    }
    ledger.prune_results(first).map(drop)
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
