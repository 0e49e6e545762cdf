//! One node: the real engine, block store and ledger on a simulated disk, driven as the node's own threads drive them
//! (`src/orderer.rs`, `src/stores.rs`, `src/gateway/`), but by events in virtual time.

mod open;
mod shelf;

pub use open::{Opened, open, open_blocks};
pub use shelf::Shelf;

use crate::clock::Clock;
use crate::coverage::Fault;
use bytes::Bytes;
use ledger::{Ledger, Refusal};
use ledger_hash::Hash;
use ledger_raft::{Engine, Input, Lane};
use ledger_rejection::Code;
use ledger_storage::block_store::BlockStore;
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::Entry;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::State;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// After this long without a verdict a client is told that the outcome is unknown (`src/waiters.rs`).
pub const WAIT_MAX: u64 = 10 * crate::clock::SECOND;
/// Longest time that a request waits for the height that it wants (`src/gateway/reads.rs`).
pub const WAIT_FOR_HEIGHT: u64 = 2 * crate::clock::SECOND;

/// A machine with a disk, and the process on it, if it runs.
pub struct Node {
    /// Its number in the ordering protocol; never used twice.
    pub id: u64,
    /// Its log.
    pub disk: SimDisk,
    /// Its world state.
    pub shelf: Shelf,
    /// The results of executed blocks.
    pub results: SimDisk,
    /// The world state at some heights.
    pub snapshots: SimDisk,
    /// Its clocks.
    pub clock: Clock,
    /// The process.
    pub up: Option<Running>,
    /// Counts starts; what an earlier process had asked for is void.
    pub start: u64,
    /// Until when the process stands still.
    pub paused_until: u64,
    /// Its disk is gone; it will never start again.
    pub lost: bool,
    /// This file was damaged on purpose; with it the node must refuse to start.
    pub damaged: Option<String>,
    /// A fault of its disk was injected that may end it until power fails, which clears it.
    pub disk_will_fail: Option<Fault>,
    /// How many blocks it keeps behind its world state; all of them if none is given.
    pub keep: Option<u64>,
    /// Height of the world state that is on its disk.
    pub saved: u64,
    /// Power fails in the middle of its next write.
    pub tear: bool,
}

/// The process of a node.
pub struct Running {
    /// Orders; none while blocks are fetched from peers.
    pub engine: Option<Engine>,
    /// The log.
    pub store: Arc<BlockStore>,
    /// The world state.
    pub state: Arc<State>,
    /// The world state at some heights.
    pub snapshots: Arc<Snapshots>,
    /// Executes.
    pub ledger: Ledger,
    /// The number of the newest flush that the engine waits for.
    pub flush: Option<u64>,
    /// A flush is under way.
    pub flushing: bool,
    /// The order thread does nothing else while it flushes, as in the node; without, more can overlap.
    pub waits_for_disk: bool,
    /// What has come in meanwhile.
    pub inbox: VecDeque<Input>,
    /// Committed and not executed.
    pub committed: VecDeque<Entry>,
    /// The execute thread has something to do.
    pub executing: bool,
    /// Who waits for the verdict on a transaction.
    pub waiters: BTreeMap<Hash, Waiting>,
    /// Another node leads than before: what waits is submitted again.
    pub submit_again: bool,
    /// Numbers what waits.
    pub next_waiting: u64,
    /// What waits for the leader's confirmation, and then for a height.
    pub reads: BTreeMap<u64, Read>,
    /// Requests that wait for a height.
    pub behind: Vec<(u64, Request)>,
    /// The log cannot be written for lack of space.
    pub disk_full: bool,
    /// The deadline for which an empty block was asked for, and the height then.
    pub asked_for: (u64, u64),
    /// The height up to which blocks are to be fetched from peers.
    pub catch_up_to: u64,
    /// It leads.
    pub leading: bool,
    /// Names of reads.
    pub next_context: u64,
}

/// A transaction whose verdict clients wait for.
#[derive(Debug)]
pub struct Waiting {
    /// In which order it came.
    pub number: u64,
    /// How urgent it is.
    pub lane: Lane,
    /// The signed bytes.
    pub encoded: Bytes,
    /// Who waits.
    pub waiters: Vec<Waiter>,
}

/// A client that waits for a verdict.
#[derive(Clone, Copy, Debug)]
pub struct Waiter {
    /// Where the answer goes.
    pub reply: Reply,
    /// When it began to wait.
    pub since: u64,
}

/// A request that waits until the node's state is as new as what was committed when it came: a read, or a transaction that
/// the state refuses.
#[derive(Clone, Debug)]
pub struct Read {
    /// What is asked.
    pub request: Request,
    /// Why the state refuses it, if it is a transaction.
    pub refusal: Option<Box<Refusal>>,
    /// The height to wait for, once it is known.
    pub index: Option<u64>,
    /// When it gives up.
    pub until: u64,
}

/// Where an answer goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reply {
    /// The client.
    pub client: usize,
    /// Its attempt; an answer to an earlier one is too late.
    pub attempt: u64,
}

/// What a client asks of a node.
#[derive(Clone, Debug)]
pub struct Request {
    /// Where the answer goes.
    pub reply: Reply,
    /// The height that the client has seen.
    pub min_height: u64,
    /// The newest height that anybody had been told when the client asked. The node does not know it.
    pub told: u64,
    /// What it wants.
    pub what: What,
}

/// What is wanted.
#[derive(Clone, Debug)]
pub enum What {
    /// Order this.
    Submit {
        /// The signed bytes.
        transaction: Bytes,
        /// The client gave it to no node before.
        first_attempt: bool,
    },
    /// Who holds a service? Asked with a certificate of [`crate::people::People`].
    Read {
        /// Index of the certificate.
        person: usize,
        /// The service.
        service: String,
        /// May it be what this node has just now?
        may_be_stale: bool,
    },
}

/// What a node answers.
#[derive(Clone, Debug)]
pub enum Answer {
    /// The transaction was executed.
    Verdict {
        /// Where.
        height: u64,
        /// See `height`.
        index: u32,
        /// The verdict.
        code: Code,
        /// The response.
        response: Bytes,
    },
    /// It was not ordered, or not that anybody knows.
    Refused(Refused),
    /// What was read.
    Value {
        /// The height that it is from.
        height: u64,
        /// The time by which it was judged.
        judged_at: u64,
        /// Whether it could be read.
        code: Code,
        /// What it is.
        response: Bytes,
    },
}

/// Why something was not done.
#[derive(Clone, Copy, Debug)]
pub struct Refused {
    /// The reason.
    pub code: Code,
    /// The height and the time by which the ledger judged, if it did.
    pub judged: Option<(u64, u64)>,
}

impl Refused {
    /// The ledger was not asked, or nobody knows.
    pub fn unordered(code: Code) -> Self {
        Self { code, judged: None }
    }
}

impl Node {
    /// All its disks: the log, results, snapshots.
    pub fn disks(&self) -> [&SimDisk; 3] {
        [&self.disk, &self.results, &self.snapshots]
    }

    /// The world state is gone, with the results of blocks.
    pub fn forget_state(&mut self, seed: u64) {
        self.shelf = Shelf::default();
        self.results = SimDisk::new(seed);
    }

    /// A new machine with empty disks.
    pub fn new(id: u64, disk_seed: u64, clock: Clock) -> Self {
        Self {
            id,
            disk: SimDisk::new(disk_seed),
            shelf: Shelf::default(),
            results: SimDisk::new(disk_seed ^ 1),
            snapshots: SimDisk::new(disk_seed ^ 2),
            clock,
            up: None,
            start: 0,
            paused_until: 0,
            lost: false,
            damaged: None,
            disk_will_fail: None,
            keep: None,
            saved: 0,
            tear: false,
        }
    }
}
