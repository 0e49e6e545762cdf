//! A node's work beside the commands, on two threads of their own. One zeroes the log ahead, answers those who have
//! waited too long and watches the disk. The other stores results and world state and makes snapshots, which may take
//! long.
//!
//! Both look seldom, and at once when whoever makes work for them rings their [bell](Bell): an idle node lets the machine
//! sleep.

mod bell;

pub(crate) use bell::Bell;

use crate::storage::retention::Pruner;
use crate::storage::space::Space;
use ledger_base::invariant::vital;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::block_store::BlockStore;
use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Shortest time between two rounds of a thread, however much there is to do.
const PAUSE: Duration = Duration::from_millis(50);
/// Longest time between two looks at the disk; shortest between two at those who wait.
const LOOK_PERIOD: Duration = Duration::from_secs(1);
/// World state is stored this often if it changed: the work that a crash leaves to be done again. Commands that meet it on
/// the disk wait longer.
const FLUSH_PERIOD: Duration = Duration::from_secs(2);
/// Results and world state in memory that are stored at once.
pub(crate) const PENDING_BYTES_MAX: usize = 4 * 1024 * 1024;
/// Old blocks are looked at this often.
const PRUNE_PERIOD: Duration = Duration::from_secs(10);

/// The bells that wake the two threads before their time.
#[derive(Default)]
pub(crate) struct Bells {
    /// Few zeros are left ahead of the log.
    pub rounds: Bell,
    /// More than [`PENDING_BYTES_MAX`] wait to be stored.
    pub storing: Bell,
}

/// The threads.
pub(crate) struct Housekeeping {
    bells: Arc<Bells>,
    threads: Vec<JoinHandle<()>>,
}

impl Housekeeping {
    /// Starts them. `sweep` ends what has waited too long, now and then.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(
        pruner: Pruner,
        space: &Arc<Space>,
        mut sweep: impl FnMut() + Send + 'static,
        bells: Arc<Bells>,
    ) -> io::Result<Self> {
        let (store, room) = (Arc::clone(&pruner.store), Arc::clone(space));
        let mut storer = Storer {
            space: Arc::clone(space),
            pruner,
            flushed: Instant::now(),
            pruned: Instant::now(),
            storing: Trouble::with("store the world state"),
            dropping: Trouble::with("drop old blocks"),
        };
        let own = Arc::clone(&bells);
        let storing = std::thread::Builder::new().name("store".into()).spawn(move || {
            vital(|| {
                while own.storing.wait(PAUSE, FLUSH_PERIOD) {
                    storer.round();
                }
                storer.flush();
            });
        })?;
        let own = Arc::clone(&bells);
        let rounds = std::thread::Builder::new().name("housekeeping".into()).spawn(move || {
            vital(|| {
                let mut rounds = Rounds { space: room, store, swept: None };
                let mut next = PAUSE;
                while own.rounds.wait(PAUSE, next) {
                    next = rounds.round(&mut sweep);
                }
            });
        })?;
        Ok(Self { bells, threads: vec![rounds, storing] })
    }

    /// Ends them; the world state is stored a last time.
    pub(crate) fn stop(self) {
        self.bells.rounds.end();
        self.bells.storing.end();
        for thread in self.threads {
            if thread.join().is_err() {
                tracing::error!("housekeeping thread panicked");
            }
        }
    }
}

/// Stores results and world state.
struct Storer {
    space: Arc<Space>,
    pruner: Pruner,
    flushed: Instant,
    pruned: Instant,
    storing: Trouble,
    dropping: Trouble,
}

impl Storer {
    fn round(&mut self) {
        let pending = self.pruner.ledger.pending_bytes();
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
        if self.space.is_full() {
            // The blocks have it; what the log still has to write goes first.
            return;
        }
        let durable = self.pruner.store.durable_index();
        match self.pruner.ledger.flush_up_to(durable, Some(&self.pruner.snapshots)) {
            Err(fault) if fault.code == Code::DiskFull => self.space.look(),
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
                tracing::error!("recovered: {}", self.what);
            }
            Err(fault) => {
                let reason = fault.to_string();
                if reason != self.reason {
                    tracing::error!(code = fault.code.name(), reason = %fault, "cannot {}; retrying", self.what);
                    self.reason = reason;
                }
            }
        }
    }
}

struct Rounds {
    space: Arc<Space>,
    store: Arc<BlockStore>,
    swept: Option<Instant>,
}

impl Rounds {
    /// How long the next one may wait.
    fn round(&mut self, sweep: &mut impl FnMut()) -> Duration {
        self.space.look();
        if self.swept.is_none_or(|swept| swept.elapsed() >= LOOK_PERIOD) {
            self.swept = Some(Instant::now());
            sweep();
        }
        // What is left on a full disk is for what ends control, not for zeros. It may be over at any moment.
        if self.space.is_full() {
            return PAUSE;
        }
        match self.store.prepare() {
            Ok(true) => PAUSE,
            Ok(false) => LOOK_PERIOD,
            Err(error) => {
                tracing::debug!(%error, "cannot zero the log ahead");
                LOOK_PERIOD
            }
        }
    }
}
