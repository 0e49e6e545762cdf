//! The driver of the ordering engine: two threads.
//!
//! The *order* thread owns the engine. It takes what comes in, sends what goes out, and writes the log: while it waits
//! for the disk, what arrives gathers and becomes the next block. The *execute* thread applies committed blocks to
//! the ledger, wakes subscribers and answers clients. Nothing else happens between a transaction and its verdict, so
//! that one command costs as few wake-ups of threads as possible.

use crate::blocks::Blocks;
use crate::clock::Clock;
use crate::peers::Peers;
use crate::waiters::Waiters;
use ledger::block_store::{BlockStore, StoreError};
use ledger::entry::Entry;
use ledger::transaction::Transaction;
use ledger::{Ledger, Rejection};
use ledger_raft::{Engine, Input, Output, Role, Status};
use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Inputs that wait for the order thread. Clients are bounded before it; this bounds peers.
const INBOX_MAX: usize = 65_536;
/// Inputs taken before the log is written, so that a flood cannot put off the write.
const INPUTS_PER_WRITE_MAX: usize = 4096;

/// Pause before a write is tried again that found no space.
const FULL_DISK_PAUSE: Duration = Duration::from_millis(100);

/// What the two threads share with the rest of the node.
pub(crate) struct Shared {
    /// The ledger that blocks are applied to.
    pub ledger: Arc<Ledger>,
    /// The log.
    pub store: Arc<BlockStore>,
    /// Where executed blocks go.
    pub blocks: Arc<Blocks>,
    /// Clients that wait for a verdict.
    pub waiters: Arc<Waiters>,
    /// The other nodes.
    pub peers: Peers,
    /// The node's clock.
    pub clock: Clock,
    /// Called once with the reason if the node cannot go on.
    pub fatal: Box<dyn Fn(Rejection) + Send + Sync>,
    /// Set while the log cannot be written for lack of space.
    pub disk_full: Arc<AtomicBool>,
}

/// The running threads.
pub(crate) struct Orderer {
    inbox: SyncSender<Input>,
    /// Tells the order thread to end; it looks at least once a tick.
    stop: Arc<AtomicBool>,
    status: Arc<Mutex<Status>>,
    executed: Arc<Mutex<BTreeMap<u32, u64>>>,
    threads: Vec<JoinHandle<()>>,
}

impl Orderer {
    /// Starts the threads. `tick` is the unit in which the engine counts its timeouts.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(engine: Engine, shared: Arc<Shared>, tick: Duration) -> io::Result<Self> {
        let (inbox, inputs) = mpsc::sync_channel(INBOX_MAX);
        let (committed, blocks) = mpsc::channel();
        let status = Arc::new(Mutex::new(engine.status()));
        let deadline = Arc::new(AtomicU64::new(shared.ledger.next_deadline().unwrap_or(u64::MAX)));
        let executed = Arc::new(Mutex::new(BTreeMap::new()));
        let execute = Execute {
            shared: Arc::clone(&shared),
            deadline: Arc::clone(&deadline),
            counts: Arc::clone(&executed),
            applied: inbox.clone(),
        };
        let stop = Arc::new(AtomicBool::new(false));
        let order = Order {
            stop: Arc::clone(&stop),
            leading: false,
            engine,
            shared,
            committed,
            outputs: Vec::new(),
            flush: None,
            status: Arc::clone(&status),
            deadline,
            asked_for: (0, 0),
        };
        let threads = vec![
            std::thread::Builder::new().name("execute".into()).spawn(move || execute.run(&blocks))?,
            std::thread::Builder::new().name("order".into()).spawn(move || order.run(&inputs, tick))?,
        ];
        Ok(Self { inbox, stop, status, executed, threads })
    }

    /// Hands in an input; false if the node stops or is flooded. Never blocks.
    pub(crate) fn input(&self, input: Input) -> bool {
        self.inbox.try_send(input).is_ok()
    }

    /// A handle for handing in inputs from elsewhere.
    pub(crate) fn inbox(&self) -> SyncSender<Input> {
        self.inbox.clone()
    }

    /// How ordering stands.
    pub(crate) fn status(&self) -> Status {
        self.status.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Transactions executed since the start, by number of the verdict's code.
    pub(crate) fn executed(&self) -> BTreeMap<u32, u64> {
        self.executed.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Ends both threads after what they are doing. Everything acknowledged is on disk already.
    pub(crate) fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                tracing::error!("a thread of the orderer had panicked");
            }
        }
    }
}

/// The order thread.
struct Order {
    engine: Engine,
    stop: Arc<AtomicBool>,
    leading: bool,
    shared: Arc<Shared>,
    committed: Sender<Vec<Entry>>,
    outputs: Vec<Output>,
    /// Number of the newest flush that the engine waits for.
    flush: Option<u64>,
    status: Arc<Mutex<Status>>,
    deadline: Arc<AtomicU64>,
    /// The deadline for which an empty block was asked for, and the height then: asked once until a block came.
    asked_for: (u64, u64),
}

impl Order {
    fn run(mut self, inputs: &Receiver<Input>, tick: Duration) {
        let mut next_tick = Instant::now();
        while !self.stop.load(Ordering::Relaxed) {
            if next_tick <= Instant::now() {
                self.step(Input::Tick);
                self.leave_full_disk();
                next_tick = (next_tick + tick).max(Instant::now());
                self.report();
            }
            self.meet_deadline();
            let wait = match self.flush {
                Some(_) if self.shared.disk_full.load(Ordering::Relaxed) => FULL_DISK_PAUSE,
                Some(_) => Duration::ZERO,
                None => self.idle_time(next_tick),
            };
            match inputs.recv_timeout(wait) {
                Ok(input) => self.step(input),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            for _ in 0..INPUTS_PER_WRITE_MAX {
                match inputs.try_recv() {
                    Ok(input) => self.step(input),
                    Err(_) => break,
                }
            }
            if !self.write() {
                return;
            }
        }
    }

    /// Until the next tick, or the next deadline of a chaincode if that is earlier.
    fn idle_time(&self, next_tick: Instant) -> Duration {
        let until_tick = next_tick.saturating_duration_since(Instant::now());
        let deadline = self.deadline.load(Ordering::Relaxed);
        match deadline.saturating_sub(self.shared.clock.now()) {
            // Asked for already, or not ours to meet.
            0 => until_tick,
            _ if !self.leading => until_tick,
            left => until_tick.min(Duration::from_micros(left)),
        }
    }

    /// A leader without space can promise nothing and answers nobody: another voter shall lead.
    fn leave_full_disk(&mut self) {
        if !self.leading || !self.shared.disk_full.load(Ordering::Relaxed) {
            return;
        }
        let status = self.engine.status();
        let voters = status.peers.iter().filter(|peer| status.membership.voters.contains(&peer.node));
        let best = voters.filter(|peer| peer.recently_active).max_by_key(|peer| peer.matched);
        if let Some(to) = best.map(|peer| peer.node) {
            self.step(Input::TransferLeadership { to });
        }
    }

    /// Orders an empty block when something is due and no traffic moved block time past it.
    fn meet_deadline(&mut self) {
        let deadline = self.deadline.load(Ordering::Relaxed);
        if !self.leading || self.shared.clock.now() < deadline {
            return;
        }
        let asking_for = (deadline, self.shared.ledger.tip().height);
        if self.asked_for != asking_for {
            self.asked_for = asking_for;
            self.step(Input::ProposeEmpty);
        }
    }

    /// Makes the log durable if the engine waits for it. False if the node cannot go on.
    fn write(&mut self) -> bool {
        let Some(ready) = self.flush.take() else { return true };
        match self.shared.store.flush() {
            Ok(_) => {
                self.step(Input::Persisted { ready });
                true
            }
            Err(StoreError::DiskFull { .. }) => {
                // Nothing of it is on disk and nobody was told otherwise: it is tried again until there is space.
                self.shared.disk_full.store(true, Ordering::Relaxed);
                self.flush = Some(ready);
                true
            }
            Err(error) => {
                (self.shared.fatal)(error.into());
                false
            }
        }
    }

    fn step(&mut self, input: Input) {
        let mut outputs = std::mem::take(&mut self.outputs);
        self.engine.step(self.shared.clock.now(), input, &mut outputs);
        for output in outputs.drain(..) {
            self.carry_out(output);
        }
        self.outputs = outputs;
    }

    fn carry_out(&mut self, output: Output) {
        match output {
            Output::Send { to, message } => {
                self.shared.peers.send(to, &message);
            }
            Output::Flush { ready } => self.flush = Some(ready),
            Output::Commit(entries) => {
                // The other end is only gone when the node has failed already.
                let _stopping = self.committed.send(entries);
            }
            Output::Role(change) => {
                self.leading = change.role == Role::Leader;
                self.asked_for = (0, 0);
                tracing::info!(role = ?change.role, leader = change.leader, term = change.term, "role");
                self.report();
            }
            Output::Membership { height, membership } => tracing::info!(height, ?membership, "members changed"),
            Output::Dropped { transaction, reason } => {
                if let Ok(transaction) = Transaction::decode(transaction) {
                    self.shared.waiters.refuse(&transaction.id(), &reason);
                }
            }
            Output::ReadReady { .. } => {}
            Output::Refused { input, reason } => tracing::warn!(?input, %reason, "ordering refused a request"),
            Output::Behind { from, first_index } => {
                tracing::warn!(from, first_index, "this node is behind what others still send");
            }
            Output::Failed(reason) => (self.shared.fatal)(reason),
        }
    }

    fn report(&self) {
        *self.status.lock().unwrap_or_else(PoisonError::into_inner) = self.engine.status();
    }
}

/// The execute thread.
struct Execute {
    shared: Arc<Shared>,
    deadline: Arc<AtomicU64>,
    counts: Arc<Mutex<BTreeMap<u32, u64>>>,
    applied: SyncSender<Input>,
}

impl Execute {
    fn run(self, blocks: &Receiver<Vec<Entry>>) {
        while let Ok(entries) = blocks.recv() {
            let Some(height) = entries.last().map(|entry| entry.index) else { continue };
            for entry in &entries {
                if let Err(fault) = self.execute(entry) {
                    (self.shared.fatal)(fault);
                    return;
                }
            }
            if self.applied.send(Input::Applied { height }).is_err() {
                return;
            }
        }
    }

    fn execute(&self, entry: &Entry) -> Result<(), Rejection> {
        let outcome = Arc::new(self.shared.ledger.apply(entry)?);
        self.shared.clock.observe(outcome.header.time);
        self.shared.waiters.resolve(&outcome, &self.shared.ledger);
        self.shared.blocks.publish(Arc::clone(&outcome));
        self.deadline.store(self.shared.ledger.next_deadline().unwrap_or(u64::MAX), Ordering::Relaxed);
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        for result in &outcome.results {
            *counts.entry(result.code).or_default() += 1;
        }
        Ok(())
    }
}
