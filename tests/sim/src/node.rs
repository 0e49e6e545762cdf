//! One node: the real replica, block store and ledger on a simulated disk. The node's threads are events in virtual time.

mod ground;
mod open;
mod seen_rules;
mod shelf;

pub use ground::Ground;
pub use open::{Keeping, open_blocks};
pub use seen_rules::SeenRules;
pub use shelf::Shelf;

use crate::clock::Clock;
use crate::coverage::Fault;
use crate::history::Asks;
use crate::world::{Fetching, Keys};
use bytes::Bytes;
use ledger::{Ledger, Rules};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_light::{Certificate, Proof, Statement};
use ledger_raft::{Desired, Lane};
use ledger_replica::catch_up::{Ballot, Holding, Look};
use ledger_replica::certifier::Certifier;
use ledger_replica::conductor::Conductor;
use ledger_replica::gateway::{Desk, InFlight, Job, Share, Shares, Turn, Turns};
use ledger_replica::space::{Space, Wrote};
use ledger_replica::witness::Said;
use ledger_replica::{Answer as Told, Asker, Event, Executor, Reads, Replica, Retries, Waiter, Waiters};
use ledger_storage::block_store::{BlockStore, StoreError};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::Entry;
use ledger_storage::snapshot::Snapshots;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, mpsc};

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
    /// The disk with its log, as it is measured.
    pub ground: Ground,
    /// Its clocks.
    pub clock: Clock,
    /// The process.
    pub up: Option<Running>,
    /// Counts starts; requests of an earlier process are void.
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
    /// The newest rules that its release speaks.
    pub speaks: Rules,
    /// The rules that its calls saw.
    pub rules: SeenRules,
    /// The proofs of blocks that changed who governs, on its disk.
    pub governing: BTreeMap<u64, Proof>,
    /// The newest statements that it has signed.
    pub signed: VecDeque<Statement>,
}

/// The process of a node.
pub struct Running {
    /// Orders; none while blocks are fetched from peers.
    pub replica: Option<Replica<Client>>,
    /// The members that the node's ledger wants.
    pub wanted: Desired,
    /// The replica is to be told so.
    pub wants_others: bool,
    /// Executes.
    pub executor: Arc<Executor>,
    /// The clients that wait for the verdict on a transaction.
    pub waiters: Arc<Waiters<Client>>,
    /// The readers that wait until the state is current.
    pub reads: Reads<Asking>,
    /// Repetitions that are ordered although the state refuses them.
    pub retries: Retries,
    /// The calls that each identity has in flight.
    pub shares: Shares,
    /// The turns to look at transactions, by number of the stream.
    pub turns: Turns<u64>,
    /// Streams of submissions.
    pub streams: BTreeMap<u64, Stream>,
    /// The height and the time by which transactions were refused that are held.
    pub judged: BTreeMap<Reply, (u64, u64)>,
    /// The answers for clients.
    pub answers: (mpsc::Sender<Verdict>, mpsc::Receiver<Verdict>),
    /// Since when clients wait.
    pub waiting: BTreeMap<Reply, u64>,
    /// The log.
    pub store: Arc<BlockStore>,
    /// The world state at some heights.
    pub snapshots: Arc<Snapshots>,
    /// The ledger that the executor applies blocks to.
    pub ledger: Arc<Ledger>,
    /// A flush is under way.
    pub flushing: bool,
    /// The order thread does nothing else while it flushes, as in the node; without, more can overlap.
    pub waits_for_disk: bool,
    /// The events that have come in meanwhile.
    pub inbox: VecDeque<Event>,
    /// Given to the execute thread, and not executed.
    pub given: VecDeque<Entry>,
    /// The execute thread has something to do.
    pub executing: bool,
    /// When the order thread is woken next.
    pub turn_at: u64,
    /// When who asks is looked after next.
    pub reads_at: u64,
    /// Requests that wait for a height.
    pub behind: Vec<(u64, Request)>,
    /// The judgement on the space that its disk has.
    pub space: Space,
    /// That disk.
    pub ground: Ground,
    /// Decides when there is an engine.
    pub conductor: Conductor,
    /// The question with which the process has started.
    pub look: Look,
    /// When that goes on although nobody answers.
    pub look_at: u64,
    /// The answers before the first engine.
    pub heard: Vec<Holding>,
    /// The first engine has started, or blocks are fetched before.
    pub begun: bool,
    /// Withholds votes.
    pub ballot: Ballot,
    /// The machine that fetches from peers.
    pub fetching: Option<Fetching>,
    /// Makes certificates of what nodes state.
    pub certifier: Certifier<Keys>,
    /// Recent certificates, by height.
    pub certificates: BTreeMap<u64, Certificate>,
    /// Height of the newest block that this process has executed and that is to be certified.
    pub stated: u64,
    /// The heights that the node has attested.
    pub said: Said,
    /// Height of the newest block that holds anything but attestations.
    pub ordinary: u64,
    /// It led when that was looked at last.
    pub leading: bool,
}

/// A stream of submissions.
pub struct Stream {
    /// Its calls.
    pub desk: Desk<Client>,
    /// The share of its owner.
    pub share: Arc<Share>,
    /// The turn that it has or waits for.
    pub turn: Option<Looking>,
    /// It waits until this time for a height, to look at what has come in a lane.
    pub reaching: Option<(Lane, u64)>,
}

/// A turn of a stream.
#[derive(Clone, Copy)]
pub struct Looking {
    /// The turn.
    pub turn: Turn,
    /// Its job.
    pub job: Job,
    /// It has it; else it waits.
    pub has: bool,
    /// No other stream of the identity had one or waited when it came.
    pub alone: bool,
    /// Turns of the lane that others have had meanwhile.
    pub passed: usize,
}

/// A client that waits for the verdict on a transaction.
pub struct Client {
    /// Where the answer goes.
    pub reply: Reply,
    /// The newest height that anybody had been told when it asked.
    pub told: u64,
    /// Its place among those in flight.
    pub place: InFlight,
    /// Which of those that came to this node it is.
    pub number: u64,
    /// Its answer.
    pub answers: mpsc::Sender<Verdict>,
}

/// The answer to a client about its transaction.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Where the answer goes.
    pub reply: Reply,
    /// The transaction.
    pub transaction: Hash,
    /// The answer.
    pub answer: Answer,
}

impl Waiter for Client {
    fn answer(self, answer: &Told<'_>) {
        let (transaction, answer) = match answer {
            Told::Executed(told) => {
                let (height, index, block) = (told.height, told.index, told.block);
                let (code, response) = (told.result.code(), told.result.response.clone());
                (told.id, Answer::Verdict { height, index, block, code, response })
            }
            Told::Refused { id, reason } => (*id, Answer::Refused(Refused::unordered(reason.code))),
        };
        let _gone = self.answers.send(Verdict { reply: self.reply, transaction, answer });
    }

    fn name(&self) -> &str {
        self.place.name()
    }

    fn is_gone(&self) -> bool {
        false
    }
}

/// A read or a stream that waits until the node's state is as new as the blocks that were committed when it came.
#[derive(Clone, Debug)]
pub enum Asking {
    /// A read.
    Read(Request),
    /// A stream, for the calls that the state refuses.
    Stream(u64),
}

impl Asker for Asking {
    fn is_gone(&self) -> bool {
        false
    }
}

/// Where an answer goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Reply {
    /// The client.
    pub client: usize,
    /// Its attempt; an answer to an earlier one is too late.
    pub attempt: u64,
}

/// A client's request to a node.
#[derive(Clone, Debug)]
pub struct Request {
    /// Where the answer goes.
    pub reply: Reply,
    /// The height that the client has seen.
    pub min_height: u64,
    /// The newest height that anybody had been told when the client asked. The node does not know it.
    pub told: u64,
    /// The stream over which it comes.
    pub stream: u64,
    /// Its wish.
    pub what: What,
}

/// The request.
#[derive(Clone, Debug)]
pub enum What {
    /// Order this.
    Submit {
        /// The signed bytes.
        transaction: Bytes,
        /// The client gave it to no node before.
        first_attempt: bool,
    },
    /// A question about a service, asked with a certificate of [`crate::people::People`].
    Read {
        /// The question.
        asks: Asks,
        /// Index of the certificate.
        person: usize,
        /// The service.
        service: String,
        /// May it be what this node has just now?
        may_be_stale: bool,
    },
}

/// The answer of a node.
#[derive(Clone, Debug)]
pub enum Answer {
    /// The transaction was executed.
    Verdict {
        /// Where.
        height: u64,
        /// See `height`.
        index: u32,
        /// The hash of the block, if it was executed just now.
        block: Option<Hash>,
        /// The verdict.
        code: Code,
        /// The response.
        response: Bytes,
    },
    /// It was not ordered, or not that anybody knows.
    Refused(Refused),
    /// The value that was read.
    Value {
        /// The height that it is from.
        height: u64,
        /// The time by which it was judged.
        judged_at: u64,
        /// Whether it could be read.
        code: Code,
        /// Its content.
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

impl Running {
    /// Makes the log durable. A disk without room gets the reserve first.
    ///
    /// # Errors
    /// As [`BlockStore::flush`].
    pub fn write_log(&mut self) -> Result<u64, StoreError> {
        loop {
            let written = self.store.flush();
            if !self.space.wrote(&mut self.ground, Wrote::from(&written)) {
                return written;
            }
        }
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

    /// The same node on another machine, with a copy of its disks. Its results are computed again.
    pub fn copied(&self, disk_seed: u64) -> Self {
        let disk = self.disk.copy(disk_seed);
        let node = Self::new(self.id, disk_seed, self.clock.clone());
        Self { ground: Ground::of(&disk), disk, signed: self.signed.clone(), ..node }
    }

    /// A new machine with empty disks.
    pub fn new(id: u64, disk_seed: u64, clock: Clock) -> Self {
        let disk = SimDisk::new(disk_seed);
        Self {
            id,
            ground: Ground::of(&disk),
            disk,
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
            speaks: Rules::NEWEST,
            rules: SeenRules::default(),
            governing: BTreeMap::new(),
            signed: VecDeque::new(),
        }
    }
}
