//! The parts of a commit, one by one, so that a change of the whole can be explained.
//!
//! `cargo bench --bench micro [-- NAME]`. It runs in a network of its own, if it may: the leg over DDS needs one.
//! `where_the_time_goes` adds the parts up and compares them with a whole commit.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a bench ends at the first fault"
)]

#[path = "micro/access.rs"]
mod access;
#[path = "micro/audit.rs"]
mod audit;
mod busy;
#[path = "micro/chain.rs"]
mod chain;
mod founding;
#[path = "micro/lines.rs"]
mod lines;
mod load;
mod network;
#[path = "micro/ordering.rs"]
mod ordering;
mod own_network;
mod report;
#[path = "micro/robot.rs"]
mod robot;
#[path = "micro/whole.rs"]
mod whole;

use bytes::Bytes;
use criterion::{Bencher, BenchmarkId, Criterion, Throughput, criterion_group};
use founding::{Founding, ONE_VOTER, bench_directory, clock, robots, twist};
use ledger::block::Payload;
use ledger::transaction::{Body, Transaction};
use ledger::{Admission, Ledger};
use ledger_abac::Grant;
use ledger_api::Context;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::key::PublicKey;
use ledger_storage::block_store::{BlockStore, Options};
use ledger_storage::disk::RealDisk;
use ledger_storage::entry::{Entry, EntryKind};
use ledger_storage::layout::GENESIS_FILE;
use ledger_storage::results::ResultStore;
use ledger_storage::state::{MemoryState, State};
use ledgerd::Node;
use std::hint::{black_box, spin_loop};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use whole::awake;

/// Block time from one block to the next, and how long commands may be executed: microseconds.
const BLOCK_EVERY: u64 = 1000;
const COMMAND_TTL: u64 = 60_000_000;
/// Transactions of a block: alone, as under load, as in a flood.
const BLOCK_TRANSACTIONS: [usize; 3] = [1, 10, 100];
/// Bytes of an entry: about one command, one camera image.
const ENTRY_BYTES: [usize; 2] = [320, 100_000];
/// Signatures that are checked together: what a gateway takes at a time, what execution does.
const TOGETHER: [usize; 3] = [2, 16, 64];
/// Bytes that are signed: those of a command.
const SIGNED_BYTES: usize = 250;
/// Time without a write, microseconds.
const PAUSES_US: [u64; 5] = [0, 50, 100, 200, 1000];

/// A ledger without a node, on which Salma holds a robot.
struct World {
    ledger: Ledger,
    founding: Founding,
    epoch: u64,
    next_seq: u64,
    nonce: u128,
}

impl World {
    fn new() -> Self {
        let founding = Founding::new(ONE_VOTER);
        let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
        let genesis = std::fs::read(founding.nodes[0].0.join(GENESIS_FILE)).unwrap();
        let ledger =
            Ledger::open(&genesis, Node::builder().registry().unwrap(), state, Arc::new(ResultStore::in_memory()))
                .unwrap();
        let mut world = Self { ledger, founding, epoch: 0, next_seq: 0, nonce: 0 };
        let setup = world.sign(&world.founding.owner.clone(), "setup", robots());
        world.block(&[setup]);
        let acquire = world.sign(&world.founding.salma.clone(), "acquire", vec![Bytes::from_static(b"Turtlebot4")]);
        let granted = world.block(&[acquire]);
        let grant: Grant = serde_json::from_slice(&granted).unwrap();
        (world.epoch, world.next_seq) = (grant.epoch, grant.next_seq);
        world
    }

    /// The node's clock: block time never stands still.
    fn now(&self) -> u64 {
        clock().max(self.ledger.tip().time + BLOCK_EVERY)
    }

    /// Signs with the certificate, which is how a first transaction travels; commands go without.
    fn sign(&mut self, who: &Context, function: &str, args: Vec<Bytes>) -> Transaction {
        let transaction = Transaction::sign(&self.body(who, function, args), &who.key).unwrap();
        transaction.with_certificate(Bytes::copy_from_slice(&who.chain[0])).unwrap()
    }

    fn body(&mut self, who: &Context, function: &str, args: Vec<Bytes>) -> Body {
        self.nonce += 1;
        Body {
            network: Bytes::copy_from_slice(&who.network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&who.chain[0]]).0),
            nonce: Bytes::copy_from_slice(&self.nonce.to_be_bytes()),
            not_after: self.now() + COMMAND_TTL,
            chaincode: "abac".into(),
            function: function.into(),
            args,
            known_block: None,
        }
    }

    fn command_body(&mut self) -> Body {
        let service = Bytes::from_static(b"Turtlebot4/cmd_vel");
        let args = vec![service, self.epoch.to_string().into(), self.next_seq.to_string().into(), twist()];
        self.next_seq += 1;
        self.body(&self.founding.salma.clone(), "set", args)
    }

    fn command(&mut self) -> Transaction {
        Transaction::sign(&self.command_body(), &self.founding.salma.key).unwrap()
    }

    fn admit(&self, transaction: &Transaction) -> Admission {
        self.ledger.admit(transaction.encoded().clone(), self.now()).unwrap()
    }

    fn entry(&self, transactions: &[Transaction]) -> Entry {
        let transactions = transactions.iter().map(|transaction| transaction.encoded().clone()).collect();
        let data = Payload { time: self.now(), transactions }.to_bytes();
        Entry { index: self.ledger.tip().height + 1, term: 1, kind: EntryKind::Normal, data }
    }

    /// Executes a block in which everything must succeed; answers with the first response.
    fn block(&self, transactions: &[Transaction]) -> Bytes {
        let outcome = self.ledger.apply(&self.entry(transactions)).unwrap();
        for result in &outcome.results {
            assert_eq!(result.code(), Code::Ok);
        }
        outcome.results[0].response.clone()
    }
}

/// Times `body` alone; `prepare` makes its input anew each time.
fn timed<T, R>(bencher: &mut Bencher<'_>, mut prepare: impl FnMut() -> T, mut body: impl FnMut(&T) -> R) {
    bencher.iter_custom(|iterations| {
        let mut total = Duration::ZERO;
        for _ in 0..iterations {
            let input = prepare();
            let start = Instant::now();
            black_box(body(&input));
            total += start.elapsed();
        }
        total
    });
}

fn signature(criterion: &mut Criterion) {
    let mut world = World::new();
    let body = world.command_body();
    let key = Arc::clone(&world.founding.salma.key);
    criterion.bench_function("sign", |bencher| bencher.iter(|| Transaction::sign(black_box(&body), &key)));
    let (transaction, public) = (Transaction::sign(&body, &key).unwrap(), key.public_key());
    criterion.bench_function("verify", |bencher| bencher.iter(|| black_box(&transaction).verify(&public)));
    for count in TOGETHER {
        let messages: Vec<_> = (0..count).map(|number| vec![number as u8; SIGNED_BYTES]).collect();
        let signatures: Vec<_> = messages.iter().map(|message| key.sign(message)).collect();
        let signed = || messages.iter().zip(&signatures).map(|(message, signed)| (&public, &message[..], &signed[..]));
        criterion.bench_function(&format!("verify_together/{count}"), |bencher| {
            bencher.iter(|| assert!(PublicKey::verify_together(signed())));
        });
    }
    let encoded = transaction.encoded();
    criterion.bench_function("decode", |bencher| bencher.iter(|| Transaction::decode(black_box(encoded.clone()))));
}

/// The gateway's work before ordering: decode, identify, verify, simulate.
fn admission(criterion: &mut Criterion) {
    let world = std::cell::RefCell::new(World::new());
    criterion.bench_function("admission", |bencher| {
        // A command that is admitted and never executed: each may have the next number.
        timed(bencher, || world.borrow_mut().command(), |transaction| world.borrow().admit(transaction));
    });
}

/// The work of every node with a committed block; one that admitted its transactions has verified them already.
fn execution(criterion: &mut Criterion) {
    for (name, admitted) in [("execute_admitted", true), ("execute_following", false)] {
        let mut group = criterion.benchmark_group(name);
        for count in BLOCK_TRANSACTIONS {
            let world = std::cell::RefCell::new(World::new());
            group.throughput(Throughput::Elements(count as u64));
            group.bench_function(BenchmarkId::from_parameter(count), |bencher| {
                let prepare = || {
                    let transactions: Vec<_> = (0..count).map(|_| world.borrow_mut().command()).collect();
                    if admitted {
                        for transaction in &transactions {
                            world.borrow().admit(transaction);
                        }
                    }
                    world.borrow().entry(&transactions)
                };
                timed(bencher, prepare, |entry| world.borrow().ledger.apply(entry).unwrap());
            });
        }
        group.finish();
    }
}

/// An empty log on the disk of the build.
fn log() -> (TempDir, BlockStore) {
    let directory = tempfile::tempdir_in(bench_directory()).unwrap();
    let disk = Arc::new(RealDisk::open(directory.path()).unwrap());
    let (store, _) = BlockStore::open(disk, Options::new([1; 32], || 1)).unwrap();
    (directory, store)
}

/// The next entry of a log, with room for it.
fn next_entry(store: &BlockStore, bytes: usize) -> Entry {
    // A thread of the node does this beside the commits.
    while store.prepare().unwrap() {}
    let data = Bytes::from(vec![7; bytes]);
    Entry { index: store.last_index() + 1, term: 1, kind: EntryKind::Normal, data }
}

fn append_and_flush(store: &BlockStore, entry: &Entry) {
    store.append(std::slice::from_ref(entry), None).unwrap();
    store.flush().unwrap();
}

/// One block on disk: the only wait for hardware in a commit.
fn store(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("append_and_flush");
    for bytes in ENTRY_BYTES {
        let (_directory, store) = log();
        group.throughput(Throughput::Bytes(bytes as u64));
        group.bench_function(BenchmarkId::from_parameter(bytes), |bencher| {
            timed(bencher, || next_entry(&store, bytes), |entry| append_and_flush(&store, entry));
        });
    }
    group.finish();
}

/// The same when nothing was written for a while: a virtual disk that is left alone answers later, and so does a
/// processor that has fallen asleep meanwhile.
fn store_after_pause(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("write_after_pause");
    for (name, keep_awake) in [("asleep", false), ("awake", true)] {
        let (_directory, store) = log();
        let _awake = keep_awake.then(awake);
        for pause in PAUSES_US {
            group.bench_function(BenchmarkId::new(name, pause), |bencher| {
                let prepare = || {
                    let entry = next_entry(&store, ENTRY_BYTES[0]);
                    let start = Instant::now();
                    while start.elapsed() < Duration::from_micros(pause) {
                        spin_loop();
                    }
                    entry
                };
                timed(bencher, prepare, |entry| append_and_flush(&store, entry));
            });
        }
    }
    group.finish();
}

criterion_group!(
    ordering,
    signature,
    admission,
    execution,
    store,
    store_after_pause,
    chain::block_encode,
    chain::recover,
    chain::state_apply
);
criterion_group!(
    deciding,
    access::authorize,
    access::chaincode_call,
    lines::one_service,
    lines::many_services,
    audit::questions
);
criterion_group!(at_the_robot, robot::gate, robot::dds_leg, robot::iceoryx2_leg);

fn main() {
    own_network::enter();
    ordering();
    deciding();
    at_the_robot();
    Criterion::default().configure_from_args().final_summary();
    // Not by criterion, because it compares.
    let (options, names): (Vec<_>, Vec<_>) = std::env::args().skip(1).partition(|argument| argument.starts_with('-'));
    if names.is_empty() || names.iter().any(|name| "where_the_time_goes".contains(name.as_str())) {
        whole::where_the_time_goes(!options.iter().any(|option| option == "--bench"));
    }
}
