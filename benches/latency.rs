//! Commit and delivery latency against message frequency, over TLS, from real processes with their data on disk.
//!
//! - `sweep`: open loop at 1 to 5000 Hz. It begins when a command (`set` of one Twist, signed) was due. It ends with
//!   its verdict at the client, and with its event at a subscriber on the other organisation's node. Percentiles as a
//!   table, in `target/bench/latency.json`, and as the paper's figure in `target/bench/latency.svg`.
//! - `side_by_side`: one in flight, at 50 Hz and at 200 Hz. It runs in turns with the floor (TLS, sign, verify,
//!   `fdatasync`: nothing else) and with etcd of one and of three nodes. So all meet the same mood of the machine. The
//!   targets are ratios of these. First alone on the machine, then *contended*: a busy loop on every processor, at
//!   normal priority.
//! - `commit/one_in_flight`: closed loop, by criterion, which tells whether it changed since the last run.
//!
//! `cargo bench --bench latency [-- sweep | side_by_side | one_in_flight]`; `LEDGERD_BENCH_SECONDS` sets the length of each
//! rate.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod busy;
mod disk;
mod draw;
mod etcd;
mod floor;
mod founding;
mod load;
mod network;
mod report;

use busy::Busy;
use criterion::Criterion;
use disk::Disk;
use draw::Curve;
use etcd::Etcd;
use floor::Floor;
use founding::{ONE_VOTER, PAPER, Shape, THREE_VOTERS, THREE_VOTERS_AND_LEARNER};
use hdrhistogram::Histogram;
use ledger_base::rejection::Code;
use load::{Run, histogram, open_loop, paced};
use network::{Arrivals, Network, Operator};
use report::{Line, Side};
use serde_json::Value;
use std::collections::HashSet;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};

/// Frequencies of ROS 2 topics, from a heartbeat to far beyond a fast controller.
const RATES_HZ: [f64; 10] = [1.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 1000.0, 2000.0, 5000.0];
/// The paper's frequency.
const PAPER_HZ: f64 = 50.0;
/// The disk alone is measured at no lower rate, or too few writes would be seen.
const DISK_HZ_MIN: f64 = 10.0;
/// Length of each rate unless the environment says otherwise.
const SECONDS_DEFAULT: f64 = 4.0;
/// Length of each rate where only it is checked that the bench works.
const SECONDS_SMOKE: f64 = 0.1;
/// Turns that each side takes in `side_by_side`.
const TURNS: u32 = 5;
/// The networks in `side_by_side`. Etcd has one and three nodes: the first and the third are its equals, the other two also
/// have an owner of robots that follows.
const LEDGERD_SIDES: [(&str, Shape); 4] = [
    ("ledgerd, one node", ONE_VOTER),
    ("ledgerd, voter and learner", PAPER),
    ("ledgerd, three voters", THREE_VOTERS),
    ("ledgerd, three voters and learner", THREE_VOTERS_AND_LEARNER),
];
/// Frequency of a fast controller.
const FAST_HZ: f64 = 200.0;
/// Bytes of a value of etcd: those of its measurements elsewhere.
const ETCD_VALUE_BYTES: usize = 100;

fn main() {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let names = ["sweep", "side_by_side", "one_in_flight"];
    let chosen = |name: &str| {
        let named = |name: &str| arguments.iter().any(|argument| argument.contains(name));
        named(name) || !names.iter().any(|name| named(name))
    };
    // Without --bench it was started as a test, which wants to know only whether it works.
    let smoke = !arguments.iter().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(SECONDS_DEFAULT, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { SECONDS_SMOKE } else { seconds });
    let mut criterion = Criterion::default().configure_from_args();
    let (mut results, mut curves) = (serde_json::Map::new(), Vec::new());
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    for shape in [ONE_VOTER, PAPER, THREE_VOTERS_AND_LEARNER] {
        let network = runtime.block_on(Network::start(shape));
        if chosen("sweep") {
            let lines = sweep(&runtime, &network, shape, duration);
            curves.extend(self::curves(shape, &lines));
            results.insert(shape.name.to_owned(), report::lines(&lines));
        }
        if chosen("one_in_flight") {
            one_in_flight(&mut criterion, &network, shape);
        }
    }
    if chosen("side_by_side") {
        results.insert("side_by_side".into(), side_by_side(&runtime, duration, smoke));
    }
    criterion.final_summary();
    if !smoke && !results.is_empty() {
        if !curves.is_empty() {
            draw::write("latency", "Latency against message frequency", ("Hz", "ms, p50 and p99"), &curves);
        }
        report::write("latency", &results.into());
    }
}

fn sweep(runtime: &Runtime, network: &Network, shape: Shape, duration: Duration) -> Vec<Line> {
    let operator = runtime.block_on(network.operator("Turtlebot4"));
    let arrivals = runtime.block_on(network.listen("Turtlebot4"));
    // The first commands bring the certificate and warm caches.
    commands(runtime, &operator, 200.0, duration.min(Duration::from_millis(500)));
    let mut disk = Disk::new();
    let lines: Vec<_> = RATES_HZ
        .iter()
        .map(|hz| {
            let first_seq = operator.next_seq();
            let (run, refused) = commands(runtime, &operator, *hz, duration);
            let delivery = delivery(&run, &arrivals, first_seq..operator.next_seq(), &refused);
            // Right after it, so that both meet the same mood of the disk.
            Line { run, refused: refused.len(), delivery, disk: disk.measure(hz.max(DISK_HZ_MIN), duration / 4) }
        })
        .collect();
    report::print_table(shape.name, &lines);
    lines
}

/// Commands at a rate, and the sequence numbers of those that were refused because more came than could be ordered.
fn commands(runtime: &Runtime, operator: &Operator, hz: f64, duration: Duration) -> (Run, HashSet<u64>) {
    let refused = Arc::new(Mutex::new(HashSet::new()));
    let run = open_loop(runtime, hz, duration, || {
        // Nobody else sends for this operator.
        let (seq, verdict, refused) = (operator.next_seq(), operator.command(), Arc::clone(&refused));
        async move {
            match verdict.await {
                Ok(_) => {}
                Err(reason) if reason.code == Code::Overloaded => drop(refused.lock().unwrap().insert(seq)),
                Err(reason) => panic!("{reason}"),
            }
        }
    });
    let refused = std::mem::take(&mut *refused.lock().unwrap());
    (run, refused)
}

/// From when the commands with these sequence numbers were due until they arrived, without those that were refused.
fn delivery(run: &Run, arrivals: &Arrivals, sequence: std::ops::Range<u64>, refused: &HashSet<u64>) -> Histogram<u64> {
    let due = |number: u32| run.start + Duration::from_secs_f64(f64::from(number) / run.hz);
    let accepted = (0..).zip(sequence).filter(|(_, seq)| !refused.contains(seq));
    histogram(accepted.map(|(number, seq)| arrivals.of(seq) - due(number)))
}

fn curves(shape: Shape, lines: &[Line]) -> Vec<Curve> {
    let curve = |what: &str, of: &dyn Fn(&Line) -> u64| Curve {
        name: format!("{} {what}", shape.name.replace('_', " ").replace("three voters and learner", "3 voters")),
        points: lines.iter().map(|line| (line.run.hz, of(line) as f64 / 1e6)).collect(),
    };
    let quantile = |quantile: f64| move |line: &Line| line.run.latency.value_at_quantile(quantile);
    vec![curve("p50", &quantile(0.5)), curve("p99", &quantile(0.99))]
}

/// Everything that the targets compare, in turns within one run.
fn side_by_side(runtime: &Runtime, duration: Duration, smoke: bool) -> Value {
    let networks = LEDGERD_SIDES.map(|(_, shape)| runtime.block_on(Network::start(shape)));
    // A client is one thread, as the floor's is: it keeps time, signs, sends and receives.
    let alone = Builder::new_current_thread().enable_all().build().unwrap();
    let operators = networks.each_ref().map(|network| alone.block_on(network.operator("Turtlebot4")));
    let mut floor = Floor::new(operators[0].command_bytes());
    let etcd: Vec<_> = Etcd::version()
        .filter(|_| !smoke)
        .map(|_| [1, 3].map(|nodes| runtime.block_on(Etcd::start(nodes, ETCD_VALUE_BYTES))))
        .into_iter()
        .flatten()
        .collect();
    let puts: Vec<_> = etcd.iter().map(|etcd| alone.block_on(etcd.client())).collect();
    let turn = duration / TURNS;
    let mut compare = |variant: &str| {
        let mut sides: Vec<Side> = Vec::new();
        for _ in 0..TURNS {
            note(&mut sides, "floor", turn, || floor.once());
            for ((name, _), operator) in LEDGERD_SIDES.iter().zip(&operators) {
                note(&mut sides, name, turn, || drop(alone.block_on(operator.command()).unwrap()));
            }
            for (name, client) in ["etcd, one node", "etcd, three nodes"].iter().zip(&puts) {
                note(&mut sides, name, turn, || alone.block_on(client.put()));
            }
        }
        report::print_sides(variant, &sides);
        report::sides(&sides)
    };
    let quiet = compare("alone on the machine");
    let _busy = Busy::on_every_processor(|| {});
    serde_json::json!({ "alone": quiet, "contended": compare("contended") })
}

/// Measures one side for a turn at each rate.
fn note(sides: &mut Vec<Side>, name: &str, turn: Duration, mut once: impl FnMut()) {
    let measured = Side {
        name: name.to_owned(),
        one_in_flight: closed(turn, &mut once),
        at_50_hz: paced(PAPER_HZ, turn, &mut once),
        at_200_hz: paced(FAST_HZ, turn, &mut once),
    };
    match sides.iter_mut().find(|side| side.name == name) {
        Some(side) => side.add(&measured),
        None => sides.push(measured),
    }
}

/// Calls one after the other.
fn closed(duration: Duration, mut once: impl FnMut()) -> Histogram<u64> {
    let start = Instant::now();
    let mut times = Vec::new();
    while start.elapsed() < duration {
        let begin = Instant::now();
        once();
        times.push(begin.elapsed());
    }
    histogram(times.into_iter())
}

fn one_in_flight(criterion: &mut Criterion, network: &Network, shape: Shape) {
    // The client on one thread: no wake-up but by the network.
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    let operator = runtime.block_on(network.operator("Husky"));
    criterion.bench_function(&format!("commit/one_in_flight/{}", shape.name), |bencher| {
        bencher.iter(|| runtime.block_on(operator.command()).unwrap());
    });
}
