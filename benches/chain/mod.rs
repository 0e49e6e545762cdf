//! A chain of commands in the first node's directory, made without a node.

use crate::founding::{Founding, clock, robots, twist};
use bytes::Bytes;
use ledger::block::Payload;
use ledger::transaction::{Body, Transaction};
use ledger::{Ledger, Outcome};
use ledger_abac::Grant;
use ledger_api::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::RealDisk;
use ledger_storage::entry::{Entry, EntryKind, HardState};
use ledger_storage::layout::{BLOCKS_DIRECTORY, GENESIS_FILE, RESULTS_DIRECTORY, SNAPSHOTS_DIRECTORY, STATE_DIRECTORY};
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{MemoryState, SledStore, State};
use ledgerd::Node;
use std::path::Path;
use std::sync::Arc;

/// Block time from one block to the next, microseconds.
const BLOCK_EVERY: u64 = 1000;
/// Blocks that are written at once.
const FLUSH_BLOCKS: u64 = 256;
/// Results and world state in memory that are stored.
const PENDING_BYTES_MAX: usize = 4 << 20;

/// A chain that is wanted.
pub(crate) struct Chain {
    /// Blocks after those that register robots and give Salma the first one.
    pub(crate) blocks: u64,
    /// Commands of a block.
    pub(crate) transactions: u64,
    /// How long commands may be executed, microseconds.
    pub(crate) ttl: u64,
    /// With world state and results, as a node that has executed it leaves it; else the node executes it when it starts.
    pub(crate) executed: bool,
}

impl Chain {
    /// Puts the chain into the first node's directory; answers with its height.
    pub(crate) fn write(&self, founding: &Founding) -> u64 {
        let mut making = Making::begin(&founding.nodes[0].0, self);
        let setup = making.sign(&founding.owner, "setup", robots());
        making.first(setup);
        let lease = ["Turtlebot4", "600000"].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let acquire = making.sign(&founding.salma, "acquire", lease.into());
        let granted = making.first(acquire);
        let Grant { epoch, mut next_seq, .. } = serde_json::from_slice(&granted.results[0].response).unwrap();
        for _ in 0..self.blocks {
            let commands = (0..self.transactions).map(|_| {
                let service = Bytes::from_static(b"Turtlebot4/cmd_vel");
                let args = vec![service, epoch.to_string().into(), next_seq.to_string().into(), twist()];
                next_seq += 1;
                making.sign(&founding.salma, "set", args)
            });
            let commands = commands.collect();
            making.append(commands);
        }
        making.flush();
        making.store.last_index()
    }
}

/// A chain in the making.
struct Making<'a> {
    wanted: &'a Chain,
    store: BlockStore,
    ledger: Ledger,
    snapshots: Snapshots,
    time: u64,
    nonce: u128,
}

impl<'a> Making<'a> {
    fn begin(data: &Path, wanted: &'a Chain) -> Self {
        let genesis = std::fs::read(data.join(GENESIS_FILE)).unwrap();
        let (_, network) = ledger::network::Genesis::from_bytes(&genesis).unwrap();
        let disk = |name: &str| Arc::new(RealDisk::open(data.join(name)).unwrap());
        let mut salt = 0;
        let options = Options::new(network.0, move || {
            salt += 1;
            salt
        });
        let (store, _) = BlockStore::open(disk(BLOCKS_DIRECTORY), options).unwrap();
        let (state, results) = if wanted.executed {
            let state = State::open(Box::new(SledStore::open(&data.join(STATE_DIRECTORY)).unwrap()));
            (state, ResultStore::open(disk(RESULTS_DIRECTORY), network).unwrap())
        } else {
            (State::open(Box::new(MemoryState::default())), ResultStore::in_memory())
        };
        let registry = Node::builder().registry().unwrap();
        let ledger = Ledger::open(&genesis, registry, Arc::new(state.unwrap()), Arc::new(results)).unwrap();
        let snapshots = Snapshots::open(disk(SNAPSHOTS_DIRECTORY), network).unwrap();
        Self { wanted, store, ledger, snapshots, time: clock(), nonce: 0 }
    }

    fn sign(&mut self, who: &Context, function: &str, args: Vec<Bytes>) -> Transaction {
        self.nonce += 1;
        let body = Body {
            network: Bytes::copy_from_slice(&who.network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&who.chain[0]]).0),
            nonce: Bytes::copy_from_slice(&self.nonce.to_be_bytes()),
            not_after: self.time + self.wanted.ttl,
            chaincode: "abac".into(),
            function: function.into(),
            args,
            known_block: None,
        };
        let transaction = Transaction::sign(&body, &who.key).unwrap();
        match function {
            "set" => transaction,
            _ => transaction.with_certificate(Bytes::copy_from_slice(&who.chain[0])).unwrap(),
        }
    }

    /// One of the first blocks: they are executed in any case, to learn the grant.
    fn first(&mut self, transaction: Transaction) -> Outcome {
        let entry = self.order(vec![transaction]);
        self.execute(&entry)
    }

    fn append(&mut self, transactions: Vec<Transaction>) {
        let entry = self.order(transactions);
        if self.wanted.executed {
            self.execute(&entry);
        }
    }

    fn order(&mut self, transactions: Vec<Transaction>) -> Entry {
        let index = self.store.last_index() + 1;
        let transactions = transactions.iter().map(|transaction| transaction.encoded().clone()).collect();
        let data = Payload { time: self.time, transactions }.to_bytes();
        self.time += BLOCK_EVERY;
        let entry = Entry { index, term: 1, kind: EntryKind::Normal, data };
        let hard_state = HardState { term: 1, vote: 1, commit: index };
        self.store.append(std::slice::from_ref(&entry), Some(&hard_state)).unwrap();
        if index.is_multiple_of(FLUSH_BLOCKS) {
            self.store.flush().unwrap();
        }
        entry
    }

    fn execute(&self, entry: &Entry) -> Outcome {
        let outcome = self.ledger.apply(entry).unwrap();
        assert_eq!(outcome.results[0].code(), Code::Ok, "{:?}", outcome.results[0]);
        if self.wanted.executed && self.ledger.pending_bytes() > PENDING_BYTES_MAX {
            self.ledger.flush(Some(&self.snapshots)).unwrap();
        }
        outcome
    }

    fn flush(&self) {
        self.store.flush().unwrap();
        if self.wanted.executed {
            self.ledger.flush(Some(&self.snapshots)).unwrap();
        }
    }
}
