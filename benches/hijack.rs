//! The paper's experiment: an authorised user at 50 Hz, an unauthorised one at 50, 500 and 5000 Hz. What does the second
//! cost the first?
//!
//! `cargo bench --bench hijack`; `LEDGERD_BENCH_SECONDS` sets the length of each run.

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
mod report;

use founding::PAPER;
use load::{Run, histogram, open_loop};
use network::{Arrivals, Network, Operator};
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// Rate of the authorised user: the paper's.
const OPERATOR_HZ: f64 = 50.0;
/// Rates of the intruder; 0 is the run to compare with.
const INTRUDER_HZ: [f64; 4] = [0.0, 50.0, 500.0, 5000.0];

fn main() {
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(10.0, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { 0.1 } else { seconds });
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    // The intruder is on threads of his own, as on a machine of his own.
    let other = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let network = runtime.block_on(Network::start(PAPER));
    let operator = runtime.block_on(network.operator("Turtlebot4"));
    let arrivals = runtime.block_on(network.listen("Turtlebot4"));
    let intruder = Arc::new(other.block_on(network.intruder()));
    commands(&runtime, &operator, &arrivals, Duration::from_millis(500));
    println!("intruder Hz  refused  operator Hz  received Hz  commit p50     p99  delivery p50     p99  (ms)");
    let mut results = Vec::new();
    for hz in INTRUDER_HZ {
        let refused = Arc::new(AtomicU64::new(0));
        let ((run, delivery, received_hz), ()) = std::thread::scope(|scope| {
            let flood = scope.spawn(|| flood(&other, &intruder, &refused, hz, duration));
            let commands = commands(&runtime, &operator, &arrivals, duration);
            flood.join().unwrap();
            (commands, ())
        });
        let [p50, p99, delivered_p50, delivered_p99] =
            [(&run.latency, 0.5), (&run.latency, 0.99), (&delivery, 0.5), (&delivery, 0.99)]
                .map(|(times, quantile)| times.value_at_quantile(quantile) as f64 / 1e6);
        let refused = refused.load(Ordering::Relaxed);
        println!(
            "{hz:11} {refused:8} {:12.1} {received_hz:12.1} {p50:11.3} {p99:7.3} {delivered_p50:13.3} {delivered_p99:7.3}",
            run.achieved_hz
        );
        results.push(json!({
            "intruder_hz": hz, "refused": refused, "operator_hz": run.achieved_hz, "received_hz": received_hz,
            "commit_ms": { "p50": p50, "p99": p99 }, "delivery_ms": { "p50": delivered_p50, "p99": delivered_p99 },
        }));
    }
    if !smoke {
        report::write("hijack", &results.into());
    }
}

/// The authorised user's run: its commits, and their delivery to the robot's owner on the other node.
fn commands(
    runtime: &Runtime,
    operator: &Operator,
    arrivals: &Arrivals,
    duration: Duration,
) -> (Run, hdrhistogram::Histogram<u64>, f64) {
    let first_seq = operator.next_seq();
    let run = open_loop(runtime, OPERATOR_HZ, duration, || {
        let verdict = operator.command();
        async move { drop(verdict.await.unwrap()) }
    });
    let arrived: Vec<_> = (first_seq..operator.next_seq()).map(|seq| arrivals.of(seq)).collect();
    let due = |number: usize| run.start + Duration::from_secs_f64(number as f64 / OPERATOR_HZ);
    let delivery = histogram(arrived.iter().enumerate().map(|(number, arrival)| *arrival - due(number)));
    let received_hz = (arrived.len() - 1) as f64 / (*arrived.last().unwrap() - arrived[0]).as_secs_f64();
    (run, delivery, received_hz)
}

/// The intruder's commands: all are refused, and counted.
fn flood(runtime: &Runtime, intruder: &Operator, refused: &Arc<AtomicU64>, hz: f64, duration: Duration) {
    if hz == 0.0 {
        return;
    }
    open_loop(runtime, hz, duration, || {
        let (verdict, refused) = (intruder.command(), Arc::clone(refused));
        async move {
            verdict.await.expect_err("a command of somebody who holds nothing was executed");
            refused.fetch_add(1, Ordering::Relaxed);
        }
    });
}
