//! Ten robots at 50 Hz for long: does a node's memory stay flat, and does its disk follow the setting for retention?
//!
//! `LEDGERD_BENCH_SECONDS=1800 cargo bench --bench soak`; a line every half minute.

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
mod network;
mod usage;

use founding::PAPER;
use load::open_loop;
use network::Network;
use std::time::{Duration, Instant};
use tokio::runtime::Builder;

/// Ten robots at 50 Hz. They share two services here; the stored part of each message is the same.
const HZ: f64 = 500.0;
/// The shortest retention, and small files, so that it can be seen at work.
const SETTINGS: &str = "[storage]\nsegment_mib = 4\nretention = \"10min\"\n";

fn main() {
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(1800.0, |text| text.parse().expect("seconds"));
    let whole = Duration::from_secs_f64(if smoke { 0.1 } else { seconds });
    let piece = whole.min(Duration::from_secs(30));
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let network = runtime.block_on(Network::start_with(PAPER, SETTINGS));
    let operator = runtime.block_on(network.operator("Turtlebot4"));
    println!("     s  transactions     p50 ms  | resident MiB, disk MiB of each node");
    let (start, mut sent) = (Instant::now(), 0);
    while start.elapsed() < whole {
        let run = open_loop(&runtime, HZ, piece, || {
            let verdict = operator.command();
            async move { drop(verdict.await.unwrap()) }
        });
        sent += run.latency.len();
        let nodes: Vec<_> = network
            .processes()
            .iter()
            .zip(network.directories())
            .map(|(process, data)| format!("{:6.1} {:7.1}", mib(usage::resident(*process)), mib(usage::on_disk(data))))
            .collect();
        let p50 = run.latency.value_at_quantile(0.5) as f64 / 1e6;
        println!("{:6.0} {sent:13} {p50:10.3}  | {}", start.elapsed().as_secs_f64(), nodes.join("  | "));
    }
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / (1 << 20) as f64
}
