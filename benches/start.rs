//! From the start of a node to the moment when it orders: with nothing on its disk, and with a long chain.
//!
//! The chain is made without a node and is as one leaves it: one command a block, 500 blocks in a second of block time,
//! log, results and world state on disk. Then the node is started and ended in turns, in order and with `kill -9`.
//!
//! `cargo bench --bench start`; `LEDGERD_BENCH_BLOCKS` sets the length of the chain.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod founding;
mod load;
mod report;
mod usage;

use founding::{Founding, ONE_VOTER, clock, robots, twist};
use ledger::archive::SNAPSHOTS_DIRECTORY;
use ledger::block::Payload;
use ledger::block_store::{BlockStore, Options};
use ledger::disk::RealDisk;
use ledger::entry::{Entry, EntryKind, HardState};
use ledger::results::{RESULTS_DIRECTORY, ResultStore};
use ledger::snapshot::Snapshots;
use ledger::state::{SledStore, State};
use ledger::transaction::{Body, Transaction};
use ledger::verify::{BLOCKS_DIRECTORY, GENESIS_FILE, STATE_DIRECTORY};
use ledger::{Bytes, Code, Hash, Ledger, Outcome};
use ledger_abac::Grant;
use ledger_api::{Client, Context};
use ledgerd::Node;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};

/// Block time from one block to the next, and how long commands may be executed, microseconds.
const BLOCK_EVERY: u64 = 2000;
const TTL: u64 = 2_000_000;
/// Blocks that are written at once.
const FLUSH_BLOCKS: u64 = 256;
/// Results and world state in memory that are stored.
const PENDING_BYTES_MAX: usize = 4 << 20;
/// Starts of each kind.
const STARTS: usize = 6;
/// Time for a start.
const START_TIME_MAX: Duration = Duration::from_secs(300);

fn main() {
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let wanted = std::env::var("LEDGERD_BENCH_BLOCKS").map_or(1_000_000, |text| text.parse().expect("a number"));
    let blocks: u64 = if smoke { 500 } else { wanted };
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let mut results = Vec::new();
    for blocks in [0, blocks] {
        let founding = Founding::new(ONE_VOTER);
        let begin = Instant::now();
        let height = if blocks == 0 { 0 } else { Chain::write(&founding, blocks) };
        let data = &founding.nodes[0].0;
        println!(
            "{height} blocks, {:.1} MiB on disk, written in {:.1} s",
            usage::on_disk(data) as f64 / f64::from(1 << 20),
            begin.elapsed().as_secs_f64()
        );
        results.push(starts(&runtime, &founding, height, if smoke { 2 } else { STARTS }));
    }
    report::write("start", &Value::from(results));
}

/// Starts the node so many times, and tells how long each took.
fn starts(runtime: &Runtime, founding: &Founding, height: u64, count: usize) -> Value {
    let mut times = Vec::new();
    for number in 0..count {
        let begin = Instant::now();
        let mut node = start(founding);
        runtime.block_on(ready(founding, height, &mut node));
        times.push(begin.elapsed().as_secs_f64() * 1e3);
        let signal = if number % 2 == 0 { Signal::TERM } else { Signal::KILL };
        kill_process(Pid::from_child(&node), signal).unwrap();
        node.wait().unwrap();
    }
    let told: Vec<String> = times.iter().map(|time| format!("{time:.0}")).collect();
    times.sort_by(f64::total_cmp);
    let (p50, max) = (times[count / 2], times[count - 1]);
    println!("  from start to ready, ms: {} (median {p50:.0}, longest {max:.0})", told.join(", "));
    json!({ "blocks": height, "ready_ms": { "p50": p50, "max": max } })
}

fn start(founding: &Founding) -> Child {
    let (data, address) = &founding.nodes[0];
    let config = data.with_extension("toml");
    std::fs::write(&config, format!("data = {data:?}\nlisten = {address:?}\n")).unwrap();
    let log = File::create(data.with_extension("log")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_ledgerd"));
    command.args(["run", "--config"]).arg(&config).stdin(Stdio::null());
    command.stdout(log.try_clone().unwrap()).stderr(log).spawn().unwrap()
}

/// Waits until the node leads and has executed the chain.
async fn ready(founding: &Founding, height: u64, node: &mut Child) {
    let deadline = Instant::now() + START_TIME_MAX;
    loop {
        if let Ok(client) = Client::connect(&founding.owner).await
            && let Ok(status) = client.status().await
            && status.role == "leader"
            && status.height > height
        {
            return;
        }
        let ended = node.try_wait().unwrap();
        if ended.is_some() || Instant::now() > deadline {
            let log = founding.nodes[0].0.with_extension("log");
            panic!("the node does not start: {}", std::fs::read_to_string(log).unwrap_or_default());
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

/// A chain in the making, in the directory of a node.
struct Chain {
    store: BlockStore,
    ledger: Ledger,
    snapshots: Snapshots,
    time: u64,
    nonce: u128,
}

impl Chain {
    /// Makes a chain with so many commands, a block each; answers with its height.
    fn write(founding: &Founding, blocks: u64) -> u64 {
        let mut chain = Self::begin(founding);
        let setup = chain.sign(&founding.owner, "setup", robots());
        chain.append(setup);
        let lease = ["Turtlebot4", "600000"].map(|arg| Bytes::copy_from_slice(arg.as_bytes()));
        let acquire = chain.sign(&founding.salma, "acquire", lease.into());
        let granted = chain.append(acquire);
        let Grant { epoch, next_seq, .. } = serde_json::from_slice(&granted.results[0].response).unwrap();
        for seq in next_seq..next_seq + blocks {
            let service = Bytes::from_static(b"Turtlebot4/cmd_vel");
            let command = chain.sign(
                &founding.salma,
                "set",
                vec![service, epoch.to_string().into(), seq.to_string().into(), twist()],
            );
            chain.append(command);
        }
        chain.flush();
        chain.store.last_index()
    }

    fn begin(founding: &Founding) -> Self {
        let data = &founding.nodes[0].0;
        let genesis = std::fs::read(data.join(GENESIS_FILE)).unwrap();
        let (_, network) = ledger::network::Genesis::from_bytes(&genesis).unwrap();
        let disk = |name: &str| Arc::new(RealDisk::open(data.join(name)).unwrap());
        let mut salt = 0;
        let options = Options::new(network.0, move || {
            salt += 1;
            salt
        });
        let (store, _) = BlockStore::open(disk(BLOCKS_DIRECTORY), options).unwrap();
        let state = State::open(Box::new(SledStore::open(&data.join(STATE_DIRECTORY)).unwrap())).unwrap();
        let results = ResultStore::open(disk(RESULTS_DIRECTORY), network).unwrap();
        let registry = Node::builder().registry().unwrap();
        let ledger = Ledger::open(&genesis, registry, Arc::new(state), Arc::new(results)).unwrap();
        let snapshots = Snapshots::open(disk(SNAPSHOTS_DIRECTORY), network).unwrap();
        Self { store, ledger, snapshots, time: clock(), nonce: 0 }
    }

    fn sign(&mut self, who: &Context, function: &str, args: Vec<Bytes>) -> Transaction {
        self.nonce += 1;
        self.time += BLOCK_EVERY;
        let body = Body {
            network: Bytes::copy_from_slice(&who.network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&who.chain[0]]).0),
            nonce: Bytes::copy_from_slice(&self.nonce.to_be_bytes()),
            not_after: self.time + TTL,
            chaincode: "abac".into(),
            function: function.into(),
            args,
        };
        let transaction = Transaction::sign(&body, &who.key).unwrap();
        match function {
            "set" => transaction,
            _ => transaction.with_certificate(Bytes::copy_from_slice(&who.chain[0])).unwrap(),
        }
    }

    /// Orders a block with this transaction and executes it.
    fn append(&mut self, transaction: Transaction) -> Outcome {
        let index = self.store.last_index() + 1;
        let data = Payload { time: self.time, transactions: vec![transaction.encoded().clone()] }.to_bytes();
        let entry = Entry { index, term: 1, kind: EntryKind::Normal, data };
        let hard_state = HardState { term: 1, vote: 1, commit: index };
        self.store.append(std::slice::from_ref(&entry), Some(&hard_state)).unwrap();
        let outcome = self.ledger.apply(&entry).unwrap();
        assert_eq!(outcome.results[0].code(), Code::Ok, "{:?}", outcome.results[0]);
        if index.is_multiple_of(FLUSH_BLOCKS) {
            self.store.flush().unwrap();
        }
        if self.ledger.pending_bytes() > PENDING_BYTES_MAX {
            self.ledger.flush(Some(&self.snapshots)).unwrap();
        }
        outcome
    }

    fn flush(&self) {
        self.store.flush().unwrap();
        self.ledger.flush(Some(&self.snapshots)).unwrap();
    }
}
