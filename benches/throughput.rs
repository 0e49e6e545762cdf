//! Throughput: closed loops of 1 to 4096 transactions in flight, with 1 to 128 messages in each. All are signed, and
//! verified on both nodes of the paper's network; beside it etcd, whose puts are neither.
//!
//! `cargo bench --bench throughput`; `LEDGERD_BENCH_SECONDS` sets the length of each run.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod etcd;
mod founding;
mod load;
mod network;
mod report;
mod usage;

use etcd::Etcd;
use founding::PAPER;
use load::{Throughput, closed_loop};
use network::Network;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

const IN_FLIGHT: [usize; 8] = [1, 4, 16, 64, 256, 1024, 2048, 4096];
const MESSAGES: [usize; 4] = [1, 8, 32, 128];
/// In flight where only the number of messages varies.
const IN_FLIGHT_BATCHED: usize = 256;

/// The use of a loop, per call.
struct Cost {
    cpu_us: f64,
    own_cpu_us: f64,
    disk_bytes: f64,
    wire_bytes: f64,
}

fn main() {
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(4.0, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { 0.05 } else { seconds });
    let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let mut results = serde_json::Map::new();
    results.insert("ledgerd".into(), ledgerd(&runtime, duration).into());
    match Etcd::version() {
        Some(version) if !smoke => {
            println!("\n{version}, one node, mutual TLS, puts of 100 bytes");
            results.insert("etcd".into(), etcd(&runtime, duration).into());
        }
        _ => println!("\nno etcd beside it (Debian: apt-get install etcd-server)"),
    }
    if !smoke {
        report::write("throughput", &results.into());
    }
}

fn ledgerd(runtime: &Runtime, duration: Duration) -> Vec<Value> {
    // So many in flight wait longer than commands should: here they may.
    let network = runtime.block_on(Network::start_with(PAPER, "[order]\nwait_ms = 60000\n"));
    let operator = Arc::new(runtime.block_on(network.operator("Turtlebot4")));
    println!(
        "\nvoter and learner; per transaction: CPU of the nodes and of the client, bytes on both disks and the wire"
    );
    let plain = IN_FLIGHT.map(|in_flight| (in_flight, 1));
    let batched = MESSAGES.map(|messages| (IN_FLIGHT_BATCHED, messages));
    let mut results = Vec::new();
    for (in_flight, messages) in plain.into_iter().chain(batched) {
        let operator = Arc::clone(&operator);
        let (run, cost) = measured(&network, || {
            closed_loop(runtime, in_flight, duration, move || {
                let verdict = operator.commands(messages);
                async move { drop(verdict.await.unwrap()) }
            })
        });
        results.push(line(&run, messages, &cost));
    }
    results
}

fn etcd(runtime: &Runtime, duration: Duration) -> Vec<Value> {
    let etcd = runtime.block_on(Etcd::start(1, 100));
    let puts = Arc::new(runtime.block_on(etcd.client()));
    let mut results = Vec::new();
    for in_flight in IN_FLIGHT.into_iter().filter(|in_flight| *in_flight <= 1024) {
        let (beside, processes) = (Arc::clone(&puts), etcd.processes());
        let before = usage::cpu(&processes);
        let run = closed_loop(runtime, in_flight, duration, move || beside.put());
        let cpu_us = (usage::cpu(&processes) - before).as_secs_f64() * 1e6 / run.done as f64;
        results.push(line(&run, 1, &Cost { cpu_us, own_cpu_us: 0.0, disk_bytes: 0.0, wire_bytes: 0.0 }));
    }
    results
}

fn measured(network: &Network, run: impl FnOnce() -> Throughput) -> (Throughput, Cost) {
    let own = [std::process::id()];
    let used = || {
        let disk: u64 = network.directories().map(usage::on_disk).sum();
        (usage::cpu(&network.processes()), usage::cpu(&own), disk, usage::on_wire())
    };
    let before = used();
    let run = run();
    let after = used();
    let per = |total: f64| total / run.done as f64;
    let cost = Cost {
        cpu_us: per((after.0 - before.0).as_secs_f64() * 1e6),
        own_cpu_us: per((after.1 - before.1).as_secs_f64() * 1e6),
        disk_bytes: per(after.2.saturating_sub(before.2) as f64),
        wire_bytes: per((after.3 - before.3) as f64),
    };
    (run, cost)
}

fn line(run: &Throughput, messages: usize, cost: &Cost) -> Value {
    let [p50, p99] = [0.5, 0.99].map(|quantile| run.latency.value_at_quantile(quantile) as f64 / 1e6);
    let Cost { cpu_us, own_cpu_us, disk_bytes, wire_bytes } = cost;
    println!(
        "{:5} in flight x {messages:3} messages: {:9.0} tx/s {:9.0} messages/s  p50 {p50:8.3} p99 {p99:8.3} ms  \
         CPU {cpu_us:6.1} + {own_cpu_us:6.1} µs  disk {disk_bytes:6.0} wire {wire_bytes:6.0} bytes",
        run.in_flight,
        run.per_second,
        run.per_second * messages as f64,
    );
    json!({
        "in_flight": run.in_flight, "messages": messages, "transactions_per_second": run.per_second,
        "messages_per_second": run.per_second * messages as f64, "latency_ms": { "p50": p50, "p99": p99 },
        "nodes_cpu_us": cpu_us, "client_cpu_us": own_cpu_us, "disk_bytes": disk_bytes, "wire_bytes": wire_bytes,
    })
}
