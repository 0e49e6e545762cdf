//! One machine: its disks, and the process on it, if it runs.

use super::people::{ORGANISATION, PEOPLE};
use bytes::Bytes;
use ledger::network::{FoundingNode, Genesis};
use ledger::{Chaincode, Context, Ledger, Registry, ServiceBudget};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::{Input, Membership};
use ledger_replica::opening::{Kept, Opening};
use ledger_replica::{Answer, Clock, Executor, Replica, Waiter, Waiters};
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::SimDisk;
use ledger_storage::entry::Entry;
use ledger_storage::result::Event;
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{MemoryState, StateRead, Store, WriteSet};
use std::collections::BTreeMap;
use std::sync::{Arc, mpsc};

/// Blocks between two snapshots at least.
const SNAPSHOT_EVERY: u64 = 4;

/// Time from a call of `alarm` until the chaincode has something to do, microseconds.
pub const ALARM: u64 = 500_000;

/// Bytes a second that the owner of the service `board` allows.
pub const BOARD_BYTES: u64 = 1_000;

/// The state to execute: it keeps the last argument, and when `alarm` was called. `publish` publishes on the service `board`.
struct Notes;

impl Chaincode for Notes {
    fn name(&self) -> &'static str {
        "notes"
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        let argument = args.first().cloned().unwrap_or_default();
        ctx.put(b"last", argument.to_vec());
        if function == "alarm" {
            ctx.put(b"alarm", (ctx.block_time() + ALARM).to_be_bytes().to_vec());
        }
        if function == "publish" {
            ctx.emit("published", "board", Vec::new());
        }
        Ok(argument)
    }

    fn urgent(&self, function: &str) -> bool {
        function == "note"
    }

    fn publishes<'a>(&self, function: &str, _: &'a [Bytes]) -> Option<(&'a str, u64)> {
        (function == "publish").then_some(("board", 1))
    }

    fn published(&self, event: &Event) -> Option<u64> {
        (event.name == "published").then_some(1)
    }

    fn service_budget(&self, _: &Context<'_>, service: &str) -> Option<ServiceBudget> {
        let (organisation, bytes_per_s) = (ORGANISATION.into(), Some(BOARD_BYTES));
        Some(ServiceBudget { service: service.into(), organisation, bytes_per_s, messages_per_s: None })
    }

    fn begin_block(&self, ctx: &mut Context<'_>) {
        if self.next_deadline(ctx).is_some_and(|due| due <= ctx.block_time()) {
            ctx.delete(b"alarm");
        }
    }

    fn next_deadline(&self, ctx: &Context<'_>) -> Option<u64> {
        let due = ctx.get(b"alarm")?;
        Some(u64::from_be_bytes(due.as_ref().try_into().unwrap()))
    }
}

/// The genesis of a network of these members, and its name.
pub fn genesis(members: &Membership, created: u64) -> (Bytes, Hash) {
    let node = |id: u64| FoundingNode {
        id,
        name: format!("node{id}"),
        organisation: ORGANISATION.into(),
        address: format!("127.0.0.1:{}", 7000 + id),
        voter: members.voters.contains(&id),
    };
    let genesis = Genesis {
        rules: ledger::Rules::NEWEST.number(),
        label: "test".into(),
        created,
        salt: Hash::ZERO,
        organisations: vec![PEOPLE.organisation()],
        nodes: members.nodes().into_iter().map(node).collect(),
        snapshot_every: SNAPSHOT_EVERY,
    };
    let bytes = genesis.to_bytes().unwrap();
    let (_, network) = Genesis::from_bytes(&bytes).unwrap();
    (bytes, network)
}

/// A client that waits for the verdict on a transaction.
pub struct Client {
    pub text: String,
    answers: mpsc::Sender<Heard>,
}

/// The answer to a client: its transaction, the code, and the height of the block, 0 if it was not ordered.
pub type Heard = (String, Code, u64);

impl Waiter for Client {
    fn answer(self, answer: &Answer<'_>) {
        let (code, height) = match answer {
            Answer::Executed(told) => (told.result.code(), told.height),
            Answer::Refused { reason, .. } => (reason.code, 0),
        };
        self.answers.send((self.text, code, height)).unwrap();
    }

    fn name(&self) -> &str {
        "Org1/Salma"
    }

    fn is_gone(&self) -> bool {
        false
    }
}

/// Where the world state is kept: whole batches, as a flush left them.
#[derive(Clone, Default)]
struct Shelf(Arc<MemoryState>);

impl Store for Shelf {
    fn get(&self, key: &[u8]) -> Result<Option<Bytes>, Rejection> {
        StateRead::get(&*self.0, key)
    }

    fn range(&self, prefix: &[u8], after: Option<&[u8]>, limit: usize) -> Result<Vec<(Bytes, Bytes)>, Rejection> {
        StateRead::range(&*self.0, prefix, after, limit)
    }

    fn write(&self, batch: &WriteSet, tip: (&[u8], &[u8])) -> Result<(), Rejection> {
        self.0.write(batch, tip)
    }
}

pub struct Node {
    pub id: u64,
    disks: Disks,
    pub up: Option<Running>,
    /// Counts starts of engines; events of an earlier one are void.
    pub start: u64,
    /// The answers to clients whose transaction was not ordered.
    pub dropped: Vec<(String, Code)>,
    pub refused: Vec<(Input, Rejection)>,
    pub reads: Vec<(u64, u64)>,
    pub members: Membership,
    /// The events that are due when a process that is stopped goes on; none while it runs.
    pub held: Option<Vec<super::Event>>,
    /// The execute thread stands still.
    pub stalled: bool,
    /// Why the node has stopped for good.
    pub failed: Option<Rejection>,
    /// Height and hash of the newest block that it has a certificate for.
    pub certified: Option<(u64, Hash)>,
}

struct Disks {
    log: SimDisk,
    results: SimDisk,
    snapshots: SimDisk,
    shelf: Shelf,
}

/// A process.
pub struct Running {
    pub replica: Option<Replica<Client>>,
    pub store: Arc<BlockStore>,
    pub snapshots: Arc<Snapshots>,
    pub executor: Arc<Executor>,
    pub waiters: Arc<Waiters<Client>>,
    pub clock: Clock,
    pub answers: (mpsc::Sender<Heard>, mpsc::Receiver<Heard>),
    /// Given to the execute thread, and not executed.
    pub given: Vec<Entry>,
    /// The members that the replica has told, by the height of the change, until that is executed.
    pub told: BTreeMap<u64, Membership>,
    /// A write of the log is under way.
    pub writing: bool,
    /// When the order thread is woken next.
    pub turn_at: u64,
}

impl Running {
    pub fn ledger(&self) -> &Arc<Ledger> {
        self.executor.ledger()
    }

    /// A client that waits here.
    pub fn client(&self, text: &str) -> Client {
        Client { text: text.to_owned(), answers: self.answers.0.clone() }
    }
}

impl Disks {
    fn new(seed: u64) -> Self {
        let [log, results, snapshots] = [0, 1, 2].map(|salt| SimDisk::new(seed ^ salt));
        Self { log, results, snapshots, shelf: Shelf::default() }
    }
}

impl Node {
    pub fn new(id: u64, disk_seed: u64, members: Membership) -> Self {
        Self {
            id,
            disks: Disks::new(disk_seed),
            up: None,
            start: 0,
            dropped: Vec::new(),
            refused: Vec::new(),
            reads: Vec::new(),
            members,
            held: None,
            stalled: false,
            failed: None,
            certified: None,
        }
    }

    /// The process starts, without an engine.
    pub fn open(&mut self, (genesis, network): &(Bytes, Hash), segment_bytes: u64, salt: u64, elapsed: u64) {
        assert!(self.up.is_none());
        let mut options = Options::new(network.0, move || salt);
        options.segment_bytes = segment_bytes;
        let (store, _) = BlockStore::open(Arc::new(self.disks.log.clone()), options).unwrap();
        let store = Arc::new(store);
        let snapshots = Arc::new(Snapshots::open(Arc::new(self.disks.snapshots.clone()), *network).unwrap());
        let mut registry = Registry::new();
        registry.install(Arc::new(Notes)).unwrap();
        let opening = Opening {
            genesis,
            registry: &registry,
            store: &store,
            snapshots: &snapshots,
            diverged: false,
            certified: self.certified,
        };
        let ledger = Arc::new(opening.open(&mut Keeping { disks: &mut self.disks, network: *network }).unwrap());
        self.members = ledger.members().unwrap();
        let waiters = Arc::new(Waiters::default());
        let clock = Clock::of(ledger.tip().time, elapsed);
        self.up = Some(Running {
            replica: None,
            store,
            snapshots,
            executor: Arc::new(Executor::new(ledger, vec![Arc::clone(&waiters) as _])),
            waiters,
            clock,
            answers: mpsc::channel(),
            given: Vec::new(),
            told: BTreeMap::new(),
            writing: false,
            turn_at: u64::MAX,
        });
    }

    /// The process ends, and the machine goes on.
    pub fn end(&mut self) {
        self.up = None;
        self.held = None;
        [&self.disks.log, &self.disks.results, &self.disks.snapshots].into_iter().for_each(SimDisk::kill);
    }

    /// Power fails: what is not flushed is lost, what is being written is torn.
    pub fn lose_power(&mut self) {
        self.up = None;
        self.held = None;
        [&self.disks.log, &self.disks.results, &self.disks.snapshots].into_iter().for_each(SimDisk::crash);
    }

    /// The disks are replaced by empty ones.
    pub fn lose_disks(&mut self, seed: u64) {
        assert!(self.up.is_none());
        self.disks = Disks::new(seed);
    }

    /// World state and results are lost, and to be computed again.
    pub fn lose_state(&mut self, seed: u64) {
        assert!(self.up.is_none());
        (self.disks.shelf, self.disks.results) = (Shelf::default(), SimDisk::new(seed));
    }
}

/// World state and results of a node that starts.
struct Keeping<'a> {
    disks: &'a mut Disks,
    network: Hash,
}

impl Kept for Keeping<'_> {
    fn state(&mut self) -> Result<Box<dyn Store>, Rejection> {
        Ok(Box::new(self.disks.shelf.clone()))
    }

    fn results(&mut self, _blocks: &Arc<BlockStore>) -> Result<ResultStore, Rejection> {
        ResultStore::open(Arc::new(self.disks.results.clone()), self.network)
    }

    fn set_aside(&mut self) -> Result<(), Rejection> {
        (self.disks.shelf, self.disks.results) = (Shelf::default(), SimDisk::new(0));
        Ok(())
    }
}
