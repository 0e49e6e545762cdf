//! From the start of a node to the moment when it orders: with nothing on its disk, and with a long chain.
//!
//! The chain is made without a node and is as one leaves it. It has one command a block, 1000 blocks in a second of
//! block time, and log, results and world state on disk. Then the node is started and ended in turns, in order and with
//! `kill -9`.
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

mod chain;
mod founding;
mod load;
mod report;
mod usage;

use chain::Chain;
use founding::{Founding, ONE_VOTER};
use ledger_api::Client;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};

/// How long commands may be executed, microseconds of block time.
const TTL: u64 = 2_000_000;
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
        let chain = Chain { blocks, transactions: 1, ttl: TTL, executed: true };
        let height = if blocks == 0 { 0 } else { chain.write(&founding) };
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
