//! The price of one more of everything: robots, users, lines, policies, organisations, voters, learners, subscribers, blocks.
//!
//! Each part has more and more of one thing on a network of real processes. It measures commit and delivery latency,
//! CPU of all nodes, memory and disk while robots are driven, by the clock, at 50 Hz and at 1000 Hz. Then it says the
//! law: flat, logarithmic or linear, and what one more costs.
//!
//! | part | what there is more of |
//! |---|---|
//! | `robots` | robots that are driven, each by a holder of its own |
//! | `users` | users, each with a key and a connection |
//! | `registered` | robots that stand still |
//! | `waiting` | users who wait for the robot that is driven |
//! | `lines` | robots with a line, each held by one and wanted by another |
//! | `policies` | rules in the policies of the robots' owner |
//! | `organisations` | organisations without nodes |
//! | `bystanders` | subscribers of robots that stand still |
//! | `subscribers` | subscribers of the robot that is driven |
//! | `learners`, `voters` | nodes |
//! | `chain` | blocks; `LEDGERD_BENCH_BLOCKS=10000000` for the longest, which takes long |
//!
//! `cargo bench --bench fleet [-- robots | users | …]`; `LEDGERD_BENCH_SECONDS` sets the length of each point. Results are in
//! `target/bench/fleet.json`, curves in `fleet.svg` (CPU) and `fleet_latency.svg`.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod chain;
mod draw;
#[path = "fleet/drivers.rs"]
mod drivers;
mod founding;
#[path = "fleet/law.rs"]
mod law;
#[path = "fleet/length.rs"]
mod length;
mod load;
mod network;
#[path = "fleet/parts.rs"]
mod parts;
#[path = "fleet/point.rs"]
mod point;
mod report;
mod usage;

use draw::Curve;
use law::law;
use point::Point;
use serde_json::{Map, Value, json};
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// Rates of all robots together, unless a part says otherwise.
const RATES_HZ: [f64; 2] = [50.0, 1000.0];
/// The rate of a test, how many numbers it tries, and its length.
const RATE_SMOKE_HZ: f64 = 100.0;
const COUNTS_SMOKE: usize = 2;
const SECONDS_SMOKE: f64 = 0.1;
/// Length of each point unless the environment says otherwise.
const SECONDS_DEFAULT: f64 = 4.0;

/// The parts: name, what one more of it is called, and what measures it.
const PARTS: [(&str, &str, Measure); 12] = [
    ("robots", "robot", parts::robots),
    ("users", "user", parts::users),
    ("registered", "registered robot", parts::registered),
    ("waiting", "waiting user", parts::waiting),
    ("lines", "robot with a line", parts::lines),
    ("policies", "policy", parts::policies),
    ("organisations", "organisation", parts::organisations),
    ("bystanders", "subscriber of another robot", parts::bystanders),
    ("subscribers", "subscriber of the same robot", parts::subscribers),
    ("learners", "learner", parts::learners),
    ("voters", "voter", parts::voters),
    ("chain", "block", length::chain),
];

type Measure = fn(&Bench) -> Vec<Point>;

/// How to measure.
pub(crate) struct Bench {
    /// Where clients run.
    pub(crate) runtime: Runtime,
    /// Length of each point.
    pub(crate) duration: Duration,
    /// Only see whether it works.
    pub(crate) smoke: bool,
}

impl Bench {
    /// Rates of all robots together.
    pub(crate) fn rates(&self) -> Vec<f64> {
        if self.smoke { vec![RATE_SMOKE_HZ] } else { RATES_HZ.to_vec() }
    }

    /// These numbers, or the first of them.
    pub(crate) fn counts(&self, all: &[usize]) -> Vec<usize> {
        all.iter().copied().take(if self.smoke { COUNTS_SMOKE } else { all.len() }).collect()
    }
}

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let named = |name: &str| arguments.iter().any(|argument| argument == name);
    let chosen = |name: &str| named(name) || !PARTS.iter().any(|(name, ..)| named(name));
    // Without --bench it was started as a test, which wants to know only whether it works.
    let smoke = !named("--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(SECONDS_DEFAULT, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { SECONDS_SMOKE } else { seconds });
    law::self_check();
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let bench = Bench { runtime, duration, smoke };
    let (mut results, mut cpu, mut latency, mut laws) = (Map::new(), Vec::new(), Vec::new(), Vec::new());
    for (name, one, measure) in PARTS.into_iter().filter(|(name, ..)| chosen(name)) {
        println!("\n{name}");
        Point::print_head();
        let points = measure(&bench);
        let found = loads(&points).into_iter().map(|load| {
            let of_load: Vec<_> = points.iter().filter(|point| point.load.name == load).collect();
            let curve = |of: &dyn Fn(&Point) -> f64| Curve {
                name: format!("{name} {load}"),
                points: of_load.iter().map(|point| (point.x, of(point))).collect(),
            };
            cpu.push(curve(&|point| point.cpu_us));
            latency.push(curve(&|point| point.p50_us() / 1e3));
            (load.to_owned(), describe(&mut laws, name, load, one, &of_load))
        });
        let found: Map<_, _> = found.collect();
        let points: Vec<_> = points.iter().map(Point::json).collect();
        results.insert(name.to_owned(), json!({ "points": points, "laws": found }));
    }
    println!("\nthe laws\n{}", laws.join("\n"));
    if !smoke {
        draw::write("fleet", "CPU of all nodes for a transaction", ("how many", "µs"), &cpu);
        draw::write("fleet_latency", "Commit latency, median", ("how many", "ms"), &latency);
        report::write("fleet", &results.into());
    }
}

/// The names of the loads that have laws, in the order in which they came.
fn loads(points: &[Point]) -> Vec<&str> {
    let mut names = Vec::new();
    for point in points.iter().filter(|point| point.load.comparable) {
        if !names.contains(&point.load.name.as_str()) {
            names.push(&point.load.name);
        }
    }
    names
}

/// The law of everything that was measured under one load, in words and for programs.
fn describe(words: &mut Vec<String>, part: &str, load: &str, one: &str, points: &[&Point]) -> Value {
    let of = |what: &str, unit: &str, of: &dyn Fn(&Point) -> Option<f64>| {
        let values: Vec<_> = points.iter().filter_map(|point| Some((point.x, of(point)?))).collect();
        (values.len() >= 2).then(|| (what.to_owned(), unit.to_owned(), law(&values)))
    };
    let also = |field: &'static str| move |point: &Point| point.more.get(field).and_then(Value::as_f64);
    let found = [
        of("commit p50", "µs", &|point| Some(point.p50_us())),
        of("commit p99", "µs", &|point| Some(point.p99_us())),
        of("CPU of all nodes per transaction", "µs", &|point| Some(point.cpu_us)),
        of("memory of a node", "MiB", &|point| Some(point.resident_mib)),
        of("disk per transaction", "bytes", &|point| Some(point.disk_bytes)),
        of("disk in all", "bytes", &also("disk_bytes")),
        of("start", "s", &also("start_s")),
    ];
    let mut laws = Map::new();
    for (what, unit, law) in found.into_iter().flatten() {
        words.push(format!("{part:14} {load:20} {what:34} {}", law.words(&unit, one)));
        laws.insert(what, json!({ "unit": unit, "law": law.json() }));
    }
    laws.into()
}
