//! A learner that was never there catches up with a long chain: how long does it take, and how fast is execution alone?
//!
//! The chain is made without nodes and put into the first node's directory, which executes it when it starts; then the
//! learner of the other organisation starts with nothing.
//!
//! `cargo bench --bench catch_up`; `LEDGERD_BENCH_TRANSACTIONS` sets the length.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod founding;
mod network;

use founding::{Founding, PAPER, clock, robots, twist};
use ledger::block::Payload;
use ledger::block_store::{BlockStore, Options};
use ledger::disk::RealDisk;
use ledger::entry::{Entry, EntryKind, HardState};
use ledger::results::ResultStore;
use ledger::state::{MemoryState, State};
use ledger::transaction::{Body, Transaction};
use ledger::verify::{BLOCKS_DIRECTORY, GENESIS_FILE};
use ledger::{Bytes, Code, Hash, Ledger};
use ledger_abac::Grant;
use ledger_api::Context;
use ledgerd::Node;
use network::Network;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::runtime::Builder;

/// Commands of a block: what gathers under load.
const BLOCK_TRANSACTIONS: u64 = 500;
/// Block time from one block to the next, and how long commands may be executed, microseconds.
const BLOCK_EVERY: u64 = 1000;
const TTL: u64 = 60_000_000;

fn main() {
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let wanted = std::env::var("LEDGERD_BENCH_TRANSACTIONS").map_or(1_000_000, |text| text.parse().expect("a number"));
    let wanted: u64 = if smoke { 1000 } else { wanted };
    let founding = Founding::new(PAPER);
    let begin = Instant::now();
    let height = write_chain(&founding, wanted.div_ceil(BLOCK_TRANSACTIONS));
    println!("{wanted} transactions in {height} blocks, signed and written in {:.1} s", begin.elapsed().as_secs_f64());
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    runtime.block_on(async {
        let mut network = Network::of(founding);
        for (node, what) in
            ["the voter starts and executes its blocks", "the learner starts and catches up"].iter().enumerate()
        {
            let begin = Instant::now();
            network.start_node(node, "");
            while network.height(node).await < height {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            let seconds = begin.elapsed().as_secs_f64();
            println!("{what}: {seconds:.1} s, {:.0} transactions a second", wanted as f64 / seconds);
        }
    });
}

/// Puts a chain into the first node's directory; answers with its height.
fn write_chain(founding: &Founding, blocks: u64) -> u64 {
    let data = &founding.nodes[0].0;
    let genesis = std::fs::read(data.join(GENESIS_FILE)).unwrap();
    let (_, network) = ledger::network::Genesis::from_bytes(&genesis).unwrap();
    let mut salt = 0;
    let disk = Arc::new(RealDisk::open(data.join(BLOCKS_DIRECTORY)).unwrap());
    let (store, _) = BlockStore::open(
        disk,
        Options::new(network.0, move || {
            salt += 1;
            salt
        }),
    )
    .unwrap();
    let mut nonce = 0_u128;
    let mut time = clock();
    let mut sign = |who: &Context, function: &str, args: Vec<Bytes>, time: u64| {
        nonce += 1;
        let body = Body {
            network: Bytes::copy_from_slice(&who.network.0),
            creator: Bytes::copy_from_slice(&Hash::of(&[&who.chain[0]]).0),
            nonce: Bytes::copy_from_slice(&nonce.to_be_bytes()),
            not_after: time + TTL,
            chaincode: "abac".into(),
            function: function.into(),
            args,
        };
        let transaction = Transaction::sign(&body, &who.key).unwrap();
        match function {
            "set" => transaction,
            _ => transaction.with_certificate(Bytes::copy_from_slice(&who.chain[0])).unwrap(),
        }
    };
    // The first two are executed here, to learn the grant.
    let state = Arc::new(State::open(Box::new(MemoryState::default())).unwrap());
    let ledger =
        Ledger::open(&genesis, Node::builder().registry().unwrap(), state, Arc::new(ResultStore::in_memory())).unwrap();
    let mut height = 0;
    let mut append = |transactions: Vec<Bytes>, time: u64| {
        height += 1;
        let data = Payload { time, transactions }.to_bytes();
        let entry = Entry { index: height, term: 1, kind: EntryKind::Normal, data };
        store.append(std::slice::from_ref(&entry), Some(&HardState { term: 1, vote: 1, commit: height })).unwrap();
        if height % 64 == 0 {
            store.flush().unwrap();
        }
        entry
    };
    let setup = sign(&founding.owner, "setup", robots(), time);
    let set_up = ledger.apply(&append(vec![setup.encoded().clone()], time)).unwrap();
    assert_eq!(set_up.results[0].code(), Code::Ok, "{:?}", set_up.results[0]);
    let lease = ["Turtlebot4", "600000"].map(|arg| Bytes::copy_from_slice(arg.as_bytes())).into();
    let acquire = sign(&founding.salma, "acquire", lease, time);
    let granted = ledger.apply(&append(vec![acquire.encoded().clone()], time)).unwrap();
    assert_eq!(granted.results[0].code(), Code::Ok, "{:?}", granted.results[0]);
    let Grant { epoch, mut next_seq, .. } = serde_json::from_slice(&granted.results[0].response).unwrap();
    for _ in 0..blocks {
        time += BLOCK_EVERY;
        let transactions = (0..BLOCK_TRANSACTIONS).map(|_| {
            let service = Bytes::from_static(b"Turtlebot4/cmd_vel");
            let args = vec![service, epoch.to_string().into(), next_seq.to_string().into(), twist()];
            next_seq += 1;
            sign(&founding.salma, "set", args, time).encoded().clone()
        });
        append(transactions.collect(), time);
    }
    store.flush().unwrap();
    store.last_index()
}
