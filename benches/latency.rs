//! Commit latency: from a command (`set` of one Twist, signed) to its verdict at the client, over TLS, from real
//! processes with their data on disk.
//!
//! - `sweep`: open loop at 1 to 1000 Hz, percentiles as a table and in `target/bench/latency.json`; beside it what the
//!   disk alone takes for the same bytes.
//! - `commit/one_in_flight`: closed loop, by criterion, which tells whether it changed since the last run.
//!
//! `cargo bench --bench latency [-- sweep | one_in_flight]`; `LEDGERD_BENCH_SECONDS` sets the length of each rate.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod disk;
mod founding;
mod load;
mod network;
mod report;

use criterion::Criterion;
use disk::Disk;
use founding::{ONE_VOTER, Shape};
use load::open_loop;
use network::Network;
use report::Line;
use serde_json::Value;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// Frequencies of ROS 2 topics, from a heartbeat to a fast controller.
const RATES_HZ: [f64; 8] = [1.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 1000.0];
/// The paper's network: one organisation orders, the other follows.
const PAPER: Shape = Shape { name: "voter_and_learner", voters: 1, learners: 1 };
/// The disk alone is measured at no lower rate, or too few writes would be seen.
const DISK_HZ_MIN: f64 = 10.0;
/// Length of each rate unless the environment says otherwise.
const SECONDS_DEFAULT: f64 = 4.0;
/// Length of each rate where only it is checked that the bench works.
const SECONDS_SMOKE: f64 = 0.1;

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let with_sweep = !arguments.iter().any(|argument| argument.contains("one_in_flight"));
    // Without --bench it was started as a test, which wants to know only whether it works.
    let smoke = !arguments.iter().any(|argument| argument == "--bench");
    let mut criterion = Criterion::default().configure_from_args();
    let mut results = serde_json::Map::new();
    for shape in [ONE_VOTER, PAPER] {
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let network = runtime.block_on(Network::start(shape));
        if with_sweep {
            results.insert(shape.name.to_owned(), sweep(&runtime, &network, shape, smoke));
        }
        one_in_flight(&mut criterion, &network, shape);
    }
    criterion.final_summary();
    if !smoke && !results.is_empty() {
        report::write("latency", &results.into());
    }
}

fn sweep(runtime: &Runtime, network: &Network, shape: Shape, smoke: bool) -> Value {
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(SECONDS_DEFAULT, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { SECONDS_SMOKE } else { seconds });
    let operator = runtime.block_on(network.operator("Turtlebot4"));
    // The first commands bring the certificate and warm caches.
    open_loop(runtime, &operator, 200.0, duration.min(Duration::from_millis(500)));
    let mut disk = Disk::new();
    let lines: Vec<_> = RATES_HZ
        .iter()
        .map(|hz| Line {
            run: open_loop(runtime, &operator, *hz, duration),
            // Right after it, so that both meet the same mood of the disk.
            disk: disk.measure(hz.max(DISK_HZ_MIN), duration / 4),
        })
        .collect();
    report::print_table(shape.name, &lines);
    report::lines(&lines)
}

fn one_in_flight(criterion: &mut Criterion, network: &Network, shape: Shape) {
    // The client on one thread: no wake-up but by the network.
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    let operator = runtime.block_on(network.operator("Husky"));
    criterion.bench_function(&format!("commit/one_in_flight/{}", shape.name), |bencher| {
        bencher.iter(|| runtime.block_on(operator.command()).unwrap());
    });
}
