//! What a node does beside its work, on a thread of its own: zero the log ahead, store the world state, answer those
//! who have waited too long, watch the disk.

use crate::gateway::NodeView;
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
/// World state is stored this often if it changed: the work that a crash leaves to be done again.
const FLUSH_PERIOD: Duration = Duration::from_millis(500);
/// World state in memory that is stored at once.
const DIRTY_BYTES_MAX: usize = 4 * 1024 * 1024;
/// Waiters are looked at this often.
const SWEEP_PERIOD: Duration = Duration::from_secs(1);
/// With less space than this left, nothing more is accepted: what was accepted must still fit.
const FREE_BYTES_MIN: u64 = 16 * 1024 * 1024;

/// The thread.
pub(crate) struct Housekeeping {
    stop: Sender<()>,
    thread: JoinHandle<()>,
}

impl Housekeeping {
    /// Starts it.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(node: Arc<NodeView>, store: Arc<BlockStore>, data: PathBuf) -> io::Result<Self> {
        let (stop, stopped) = mpsc::channel();
        let thread = std::thread::Builder::new().name("housekeeping".into()).spawn(move || {
            let mut rounds = Rounds { node, store, data, flushed: Instant::now(), swept: None };
            while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                rounds.round();
            }
            rounds.flush();
        })?;
        Ok(Self { stop, thread })
    }

    /// Ends it; the world state is stored a last time.
    pub(crate) fn stop(self) {
        drop(self.stop);
        if self.thread.join().is_err() {
            tracing::error!("housekeeping had panicked");
        }
    }
}

struct Rounds {
    node: Arc<NodeView>,
    store: Arc<BlockStore>,
    data: PathBuf,
    flushed: Instant,
    swept: Option<Instant>,
}

impl Rounds {
    fn round(&mut self) {
        self.watch_disk();
        if let Err(error) = self.store.prepare() {
            tracing::debug!(%error, "cannot zero the log ahead");
        }
        let dirty = self.node.ledger.state().dirty_bytes();
        if dirty > DIRTY_BYTES_MAX || (dirty > 0 && self.flushed.elapsed() >= FLUSH_PERIOD) {
            self.flush();
        }
        if self.swept.is_none_or(|swept| swept.elapsed() >= SWEEP_PERIOD) {
            self.swept = Some(Instant::now());
            self.node.waiters.sweep();
        }
    }

    fn flush(&mut self) {
        self.flushed = Instant::now();
        if self.node.disk_full.load(Ordering::Relaxed) {
            // The blocks have it; what the log still has to write goes first.
            return;
        }
        match self.node.ledger.state().flush() {
            Ok(()) => {}
            Err(fault) if fault.code == Code::DiskFull => self.set_full(true),
            // Nothing is lost: the blocks have it, and the next start rebuilds what is missing.
            Err(fault) => tracing::error!(%fault, "cannot store the world state"),
        }
    }

    fn watch_disk(&self) {
        match free_bytes(&self.data) {
            Ok(free) => self.set_full(free < FREE_BYTES_MIN),
            Err(error) => tracing::debug!(%error, "cannot ask how much space is left"),
        }
    }

    fn set_full(&self, full: bool) {
        if self.node.disk_full.swap(full, Ordering::Relaxed) != full {
            match full {
                true => {
                    tracing::error!(data = %self.data.display(), "the disk is almost full; nothing more is accepted")
                }
                false => tracing::info!("there is space on the disk again"),
            }
        }
    }
}

fn free_bytes(path: &Path) -> io::Result<u64> {
    let found = rustix::fs::statvfs(path)?;
    Ok(found.f_bavail.saturating_mul(found.f_frsize))
}
