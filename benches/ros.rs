//! From ROS sample to ROS sample: an operator's node publishes `geometry_msgs/msg/Twist`, and the robot's node receives
//! it. Between them are her bridge, her node and the robot's node with its bridge inside, each a process of its own, as
//! in the paper's network.
//!
//! Open loop, from the time a sample was due until the robot's node has it; over DDS at both ends, and over shared memory
//! (iceoryx2) at both ends. In turns with it, so that all meet the same mood of the machine:
//! - the floor: the same sample from publisher to subscriber with nothing of ours between them;
//! - commit: the same command, signed by a client, until its verdict; and until its event at a subscriber of the
//!   robot's node. The bridges add sample to sample less that.
//!
//! `cargo bench --bench ros [-- dds | shared_memory]`; `LEDGERD_BENCH_SECONDS` sets the length of each rate. Runs in a network of its own.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod founding;
#[path = "ros/graph.rs"]
mod graph;
mod load;
mod network;
mod own_network;
mod report;
#[path = "ros/site.rs"]
mod site;
mod usage;

use graph::{Ends, Middleware};
use hdrhistogram::Histogram;
use load::{histogram, open_loop};
use network::{Arrivals, Operator};
use serde_json::{Value, json};
use site::Site;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// Frequencies of ROS 2 topics; the paper's is 50 Hz.
const RATES_HZ: [f64; 4] = [10.0, 50.0, 200.0, 1000.0];
/// Turns that each side takes at each rate.
const TURNS: u32 = 8;
/// ROS domains of the operator, of the robot, and of the floor. Shared memory has no namespaces: those of tests differ.
const OPERATOR_DOMAIN: u16 = 211;
const ROBOT_DOMAIN: u16 = 212;
const FLOOR_DOMAIN: u16 = 213;

/// The outcome of one middleware at one rate. Latencies are in nanoseconds.
struct Line {
    middleware: Middleware,
    hz: f64,
    lost: usize,
    samples: Histogram<u64>,
    floor: Histogram<u64>,
    commit: Histogram<u64>,
    delivery: Histogram<u64>,
}

fn main() {
    assert!(own_network::enter(), "needs a network of its own: `unshare`, `ip`, and the right to use them");
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(6.0, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { 0.6 } else { seconds }) / TURNS;
    let rates = if smoke { &RATES_HZ[..2] } else { &RATES_HZ[..] };
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let site = runtime.block_on(Site::start(OPERATOR_DOMAIN, ROBOT_DOMAIN));
    // Her bridge has the Turtlebot4; beside it, she drives the Husky with a client.
    let operator = runtime.block_on(site.network.operator("Husky"));
    let arrivals = runtime.block_on(site.network.listen("Husky"));
    let both = [Middleware::Dds, Middleware::SharedMemory];
    let named = |middleware: &Middleware| std::env::args().any(|argument| argument == middleware.name());
    let chosen = |middleware: &Middleware| named(middleware) || !both.iter().any(named);
    let lines: Vec<Line> = both
        .into_iter()
        .filter(chosen)
        .flat_map(|middleware| measure(&runtime, &operator, &arrivals, middleware, rates, duration))
        .collect();
    print(&lines);
    let resident = usage::resident(site.robots_node()) as f64 / f64::from(1 << 20);
    let bridge = site.stop();
    println!(
        "\noperator's bridge: {bridge}\nrobot's node, a follower with a bridge inside: {resident:.1} MiB resident"
    );
    if !smoke {
        let lines: Value = lines.iter().map(Line::json).collect();
        report::write("ros", &json!({ "lines": lines, "bridge": bridge, "robots_node_mib": resident }));
    }
}

fn measure(
    runtime: &Runtime,
    operator: &Operator,
    arrivals: &Arrivals,
    middleware: Middleware,
    rates: &[f64],
    duration: Duration,
) -> Vec<Line> {
    let mut ends = runtime.block_on(Ends::open(middleware, OPERATOR_DOMAIN, ROBOT_DOMAIN));
    let mut floor = runtime.block_on(Ends::open(middleware, FLOOR_DOMAIN, FLOOR_DOMAIN));
    // Certificates travel, caches warm up.
    ends.run(runtime, 50.0, Duration::from_secs(1));
    let line = |hz: &f64| {
        let mut line = Line::new(middleware, *hz);
        for _ in 0..TURNS {
            let (samples, lost) = ends.run(runtime, *hz, duration);
            line.samples.add(samples).unwrap();
            line.lost += lost;
            line.floor.add(floor.run(runtime, *hz, duration).0).unwrap();
            let first_seq = operator.next_seq();
            let run = open_loop(runtime, *hz, duration, || {
                let verdict = operator.command();
                async move { drop(verdict.await.unwrap()) }
            });
            let due = |number: u32| run.start + Duration::from_secs_f64(f64::from(number) / hz);
            let events = (0..).zip(first_seq..operator.next_seq());
            line.delivery.add(histogram(events.map(|(number, seq)| arrivals.of(seq) - due(number)))).unwrap();
            line.commit.add(run.latency).unwrap();
        }
        line
    };
    rates.iter().map(line).collect()
}

impl Line {
    fn new(middleware: Middleware, hz: f64) -> Self {
        let [samples, floor, commit, delivery] = std::array::from_fn(|_| histogram(std::iter::empty()));
        Self { middleware, hz, lost: 0, samples, floor, commit, delivery }
    }

    /// The median that the bridges add beyond the commit, milliseconds.
    fn added(&self) -> f64 {
        median(&self.samples) - median(&self.commit)
    }

    /// The parts of the median: into the operator's bridge, to the event at the robot's node, out of its bridge. The
    /// bridges themselves, the gate above all, are the rest of the whole.
    fn parts(&self) -> f64 {
        2.0 * median(&self.floor) + median(&self.delivery)
    }

    fn json(&self) -> Value {
        json!({
            "middleware": self.middleware.name(), "hz": self.hz, "lost": self.lost, "added_beyond_commit_ms": self.added(),
            "sample_to_sample_ms": report::percentiles(&self.samples), "floor_ms": report::percentiles(&self.floor),
            "commit_ms": report::percentiles(&self.commit), "event_ms": report::percentiles(&self.delivery),
            "two_floors_and_event_ms": self.parts(),
        })
    }
}

fn print(lines: &[Line]) {
    println!("\nms, from when a sample was due:");
    println!(
        "                   Hz  samples  lost | sample to sample p50     p99 | floor p50     p99 | commit p50     p99 | event p50 | added beyond commit | 2 floors + event"
    );
    for line in lines {
        let [p50, p99, floor, floor_p99, commit, commit_p99] = [
            (&line.samples, 0.5),
            (&line.samples, 0.99),
            (&line.floor, 0.5),
            (&line.floor, 0.99),
            (&line.commit, 0.5),
            (&line.commit, 0.99),
        ]
        .map(|(times, quantile)| times.value_at_quantile(quantile) as f64 / 1e6);
        println!(
            "{:14} {:6} {:8} {:5} | {p50:20.3} {p99:7.3} | {floor:9.3} {floor_p99:7.3} | {commit:10.3} {commit_p99:7.3} | {:9.3} | {:19.3} | {:9.3} ({:3.0} %)",
            line.middleware.name(),
            line.hz,
            line.samples.len(),
            line.lost,
            median(&line.delivery),
            line.added(),
            line.parts(),
            100.0 * line.parts() / p50,
        );
    }
}

fn median(times: &Histogram<u64>) -> f64 {
    times.value_at_quantile(0.5) as f64 / 1e6
}
