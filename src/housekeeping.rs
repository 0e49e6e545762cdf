//! What a node does beside its work, on two threads of their own. One zeroes the log ahead, answers those who have waited
//! too long and watches the disk. The other stores results and world state and makes snapshots, which may take long.

use crate::gateway::NodeView;
use crate::retention::Pruner;
use ledger_rejection::{Code, Rejection};
use ledger_storage::block_store::BlockStore;
use std::io;
use std::sync::Arc;
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
        let store = Arc::clone(&pruner.store);
        let mut keeper = Keeper {
            node: Arc::clone(&node),
            pruner,
            flushed: Instant::now(),
            pruned: Instant::now(),
            storing: Trouble::with("store the world state"),
            dropping: Trouble::with("drop old blocks"),
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
            let mut rounds = Rounds { node, store, swept: None };
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
                tracing::error!("a thread of housekeeping panicked");
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
    storing: Trouble,
    dropping: Trouble,
}

impl Keeper {
    fn round(&mut self) {
        let pending = self.node.ledger.pending_bytes();
        if pending > PENDING_BYTES_MAX || (pending > 0 && self.flushed.elapsed() >= FLUSH_PERIOD) {
            self.flush();
        }
        if self.pruned.elapsed() >= PRUNE_PERIOD {
            self.pruned = Instant::now();
            self.dropping.note(self.pruner.prune());
        }
    }

    fn flush(&mut self) {
        self.flushed = Instant::now();
        if self.node.space.is_full() {
            // The blocks have it; what the log still has to write goes first.
            return;
        }
        let durable = self.pruner.store.durable_index();
        match self.node.ledger.flush_up_to(durable, Some(&self.pruner.snapshots)) {
            Err(fault) if fault.code == Code::DiskFull => self.node.space.look(),
            // Nothing is lost: the blocks have it, and the next start rebuilds what is missing.
            stored => self.storing.note(stored),
        }
    }
}

/// Something that is tried again and again: that it fails is said once for each reason, that it works again, too.
struct Trouble {
    what: &'static str,
    /// Why it failed last; empty if it did not.
    reason: String,
}

impl Trouble {
    fn with(what: &'static str) -> Self {
        Self { what, reason: String::new() }
    }

    fn note(&mut self, result: Result<(), Rejection>) {
        match result {
            Ok(()) if self.reason.is_empty() => {}
            Ok(()) => {
                self.reason.clear();
                tracing::error!("can {} again", self.what);
            }
            Err(fault) => {
                let reason = fault.to_string();
                if reason != self.reason {
                    tracing::error!(%fault, "cannot {}; trying again", self.what);
                    self.reason = reason;
                }
            }
        }
    }
}

struct Rounds {
    node: Arc<NodeView>,
    store: Arc<BlockStore>,
    swept: Option<Instant>,
}

impl Rounds {
    fn round(&mut self) {
        self.node.space.look();
        // What is left on a full disk is for what ends control, not for zeros.
        if !self.node.space.is_full()
            && let Err(error) = self.store.prepare()
        {
            tracing::debug!(%error, "cannot zero the log ahead");
        }
        if self.swept.is_none_or(|swept| swept.elapsed() >= SWEEP_PERIOD) {
            self.swept = Some(Instant::now());
            self.node.waiters.sweep();
        }
    }
}
