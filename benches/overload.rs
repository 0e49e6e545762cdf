//! Twice of what the network carries: how long do accepted commands wait, and what are the others told? How long do
//! calls wait that give and end control, and somebody who drives another robot at 50 Hz? How long does a robot drive on that is
//! stopped in an emergency?
//!
//! `cargo bench --bench overload`; `LEDGERD_BENCH_SECONDS` sets the length of each run.

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
mod own_network;
mod report;
#[path = "overload/stops.rs"]
mod stops;

use founding::{Founding, PAPER};
use hdrhistogram::Histogram;
use ledger::transaction::Transaction;
use ledger_base::rejection::{Code, Rejection};
use load::{Run, closed_loop, histogram, open_loop};
use network::{Arrivals, Network, Operator};
use report::percentiles;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};
use stops::Stops;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::mpsc;

/// Identities that flood, each its own robot.
const FLOODERS: usize = 4;
/// Under way in the closed loop that finds the capacity, of each of them.
const IN_FLIGHT: usize = 32;
/// The load, as a multiple of the capacity; 0 is the run to compare with.
const MULTIPLES: [f64; 3] = [0.0, 1.0, 2.0];
/// Rate of the operator of another robot: the paper's.
const OPERATOR_HZ: f64 = 50.0;
/// Rate of the calls that give and end control.
const CONTROL_HZ: f64 = 10.0;
/// The flood comes in bursts, one in this time, because a sender that is woken for each command would need a core.
const BURST_EVERY: Duration = Duration::from_millis(1);
/// Flooding commands are signed before the run.
const FLOOD_TTL: Duration = Duration::from_secs(110);

/// The participants.
struct People {
    flooders: Vec<Arc<Operator>>,
    /// Drives a robot of their own all the time.
    operator: Operator,
    arrivals: Arrivals,
    /// Acquires and releases a robot.
    controller: Arc<Operator>,
    /// Does the controller hold it?
    held: AtomicBool,
    /// Calls that were refused: those that came before the one before them was executed.
    uncontrolled: Arc<AtomicUsize>,
    /// Drive a robot, and stop it.
    stops: Mutex<Stops>,
}

/// The fate of the flood.
struct Flood {
    sent: usize,
    seconds: f64,
    /// From when an accepted one was due to its verdict.
    accepted: Histogram<u64>,
    refused: BTreeMap<String, u64>,
}

/// The outcome of one run.
struct Outcome {
    multiple: f64,
    flood: Flood,
    operator: Run,
    delivery: Histogram<u64>,
    control: Run,
    /// From the call of `stop` to its verdict, and to the stop message on the robot's topic.
    stops: [Histogram<u64>; 2],
    /// Renewals by somebody who floods, over the same connection.
    renewals: Run,
    /// Commands of the operator, and calls that give and end control, that were refused.
    refused: (usize, usize),
}

fn main() {
    assert!(own_network::enter(), "needs a network of its own: `unshare`, `ip`, and the right to use them");
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(20.0, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { 0.3 } else { seconds });
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    // The flood is on threads of its own, as on machines of its own.
    let other = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let founding = Founding::new(PAPER);
    let site = stops::Site::of(&founding);
    let network = runtime.block_on(Network::start_founded(founding, ""));
    let people = people(&runtime, &other, &network, site);

    let capacity = capacity(&other, &people.flooders, duration / 4);
    println!("capacity: {capacity:.0} commands/s of {FLOODERS} identities in a closed loop\n");
    println!(
        "  load  accepted/s  refused/s  p50     p99     max  | control p50     p99     max | same stream p99 | 50 Hz p50     \
         p99  delivery p99 | stop p99 | heard p50     p99     max \
         (ms)"
    );
    let mut outcomes = Vec::new();
    for multiple in MULTIPLES {
        let outcome = run(&runtime, &other, &people, multiple, multiple * capacity, duration);
        print(&outcome);
        outcomes.push(json(&outcome));
    }
    let status = runtime.block_on(people.operator.status());
    println!("\nthe first node counted, by code: {:?}; in flight after it: {}", status.refused, status.in_flight);
    if !smoke {
        report::write("overload", &json!({ "capacity_per_second": capacity, "runs": outcomes }));
    }
}

fn people(runtime: &Runtime, other: &Runtime, network: &Network, site: stops::Site) -> People {
    let names: Vec<_> = (0..FLOODERS).map(|number| format!("Flooded{number}")).collect();
    let robots: Vec<_> = names.iter().map(String::as_str).chain(["Driven", "Controlled", stops::ROBOT]).collect();
    runtime.block_on(network.register(&robots));
    let flooders = names.iter().enumerate().map(|(number, robot)| other.block_on(network.driver(number, robot)));
    let flooders: Vec<_> = flooders.map(Arc::new).collect();
    let operator = runtime.block_on(network.driver(FLOODERS, "Driven"));
    let controller = Arc::new(runtime.block_on(network.driver(FLOODERS + 1, "Controlled")));
    let arrivals = runtime.block_on(network.listen("Driven"));
    let stops = Mutex::new(runtime.block_on(site.open(network, FLOODERS + 2)));
    let (held, uncontrolled) = (AtomicBool::new(true), Arc::default());
    People { flooders, operator, arrivals, controller, held, uncontrolled, stops }
}

/// The transactions of the flooders that are accepted in a second while they wait for their verdicts.
fn capacity(runtime: &Runtime, flooders: &[Arc<Operator>], duration: Duration) -> f64 {
    let (next, accepted) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let (flooders, counted) = (flooders.to_vec(), Arc::clone(&accepted));
    let run = closed_loop(runtime, FLOODERS * IN_FLIGHT, duration, move || {
        let verdict = flooders[next.fetch_add(1, Ordering::Relaxed) % FLOODERS].command();
        let counted = Arc::clone(&counted);
        async move {
            match verdict.await {
                Ok(_) => drop(counted.fetch_add(1, Ordering::Relaxed)),
                Err(reason) => drop(name(&reason)),
            }
        }
    });
    run.per_second * accepted.load(Ordering::Relaxed) as f64 / run.done as f64
}

fn run(runtime: &Runtime, other: &Runtime, people: &People, multiple: f64, hz: f64, duration: Duration) -> Outcome {
    let commands = (hz * duration.as_secs_f64()) as usize;
    let signed = sign(&people.flooders, commands);
    let first_seq = people.operator.next_seq();
    std::thread::scope(|scope| {
        let flood = scope.spawn(|| flood(other, &people.flooders, &signed, duration));
        let control = scope.spawn(|| control(runtime, people, duration));
        let renewals = scope.spawn(|| renewals(runtime, &people.flooders[0], duration));
        let stops = scope.spawn(|| runtime.block_on(people.stops.lock().unwrap().run(duration)));
        let missed = Arc::new(Mutex::new(Vec::new()));
        let operator = open_loop(runtime, OPERATOR_HZ, duration, || {
            let (seq, verdict, missed) = (people.operator.next_seq(), people.operator.command(), Arc::clone(&missed));
            async move {
                if verdict.await.is_err() {
                    missed.lock().unwrap().push(seq);
                }
            }
        });
        let missed = std::mem::take(&mut *missed.lock().unwrap());
        let delivery = delivery(&operator, &people.arrivals, first_seq..people.operator.next_seq(), &missed);
        let refused = (missed.len(), people.uncontrolled.swap(0, Ordering::Relaxed));
        let (flood, control, renewals) = (flood.join().unwrap(), control.join().unwrap(), renewals.join().unwrap());
        let stops = stops.join().unwrap();
        Outcome { multiple, flood, operator, delivery, control, stops, renewals, refused }
    })
}

/// Signs so many commands, of each flooder in turn.
fn sign(flooders: &[Arc<Operator>], commands: usize) -> Vec<Transaction> {
    (0..commands).map(|number| flooders[number % FLOODERS].signed(FLOOD_TTL)).collect()
}

/// Sends what is signed, spread over the duration, whatever becomes of it.
fn flood(runtime: &Runtime, flooders: &[Arc<Operator>], signed: &[Transaction], duration: Duration) -> Flood {
    let _context = runtime.enter();
    let (samples, mut done) = mpsc::unbounded_channel();
    let start = Instant::now();
    let bursts =
        if signed.is_empty() { 0 } else { (duration.as_secs_f64() / BURST_EVERY.as_secs_f64()).ceil() as usize };
    let mut sent = 0;
    for burst in 1..=bursts {
        let due = start + BURST_EVERY * burst as u32;
        sleep(due.saturating_duration_since(Instant::now()));
        let until = signed.len() * burst / bursts;
        for number in sent..until {
            let verdict = flooders[number % FLOODERS].send(&signed[number]);
            let samples = samples.clone();
            runtime.spawn(async move {
                let outcome = verdict.await.map(|_| due.elapsed());
                samples.send(outcome).unwrap();
            });
        }
        sent = until;
    }
    let seconds = start.elapsed().max(duration).as_secs_f64();
    drop(samples);
    let (mut accepted, mut refused) = (Vec::new(), BTreeMap::new());
    while let Some(outcome) = done.blocking_recv() {
        match outcome {
            Ok(after) => accepted.push(after),
            Err(reason) => *refused.entry(name(&reason)).or_default() += 1,
        }
    }
    Flood { sent, seconds, accepted: histogram(accepted.into_iter()), refused }
}

/// A refusal as it is called in results.
fn name(reason: &Rejection) -> String {
    assert_eq!(reason.code, Code::Overloaded, "{reason}");
    // Whoever it is about stands in front.
    let message = match reason.message.split_once(' ') {
        Some((identity, rest)) if identity.contains('/') => rest,
        _ => reason.message.as_str(),
    };
    format!("{}: {message}", reason.code.name())
}

/// Acquires and releases a robot in turn.
fn control(runtime: &Runtime, people: &People, duration: Duration) -> Run {
    open_loop(runtime, CONTROL_HZ, duration, || {
        let (controller, refused) = (Arc::clone(&people.controller), Arc::clone(&people.uncontrolled));
        let release = people.held.fetch_xor(true, Ordering::Relaxed);
        async move {
            let call = if release { controller.release().await } else { controller.acquire().await };
            if call.is_err() {
                refused.fetch_add(1, Ordering::Relaxed);
            }
        }
    })
}

fn renewals(runtime: &Runtime, flooder: &Arc<Operator>, duration: Duration) -> Run {
    open_loop(runtime, CONTROL_HZ, duration, || {
        let flooder = Arc::clone(flooder);
        async move { flooder.renew().await.unwrap() }
    })
}

fn delivery(run: &Run, arrivals: &Arrivals, seqs: Range<u64>, missed: &[u64]) -> Histogram<u64> {
    let due = |number: u32| run.start + Duration::from_secs_f64(f64::from(number) / OPERATOR_HZ);
    let delivered = (0..).zip(seqs).filter(|(_, seq)| !missed.contains(seq));
    histogram(delivered.map(|(number, seq)| arrivals.of(seq).saturating_duration_since(due(number))))
}

fn print(Outcome { multiple, flood, operator, delivery, control, stops, renewals, refused }: &Outcome) {
    let at = |times: &Histogram<u64>, quantile| times.value_at_quantile(quantile) as f64 / 1e6;
    let flood_refused: u64 = flood.refused.values().sum();
    let per_second = |count: u64| count as f64 / flood.seconds;
    println!(
        "{multiple:4.1} x  {:10.0} {:10.0} {:7.2} {:7.2} {:7.2} | {:11.2} {:7.2} {:7.2} | {:15.2} | {:9.2} {:7.2} {:13.2} | \
         {:8.2} | {:9.2} {:7.2} {:7.2}",
        per_second(flood.accepted.len()),
        per_second(flood_refused),
        at(&flood.accepted, 0.5),
        at(&flood.accepted, 0.99),
        at(&flood.accepted, 1.0),
        at(&control.latency, 0.5),
        at(&control.latency, 0.99),
        at(&control.latency, 1.0),
        at(&renewals.latency, 0.99),
        at(&operator.latency, 0.5),
        at(&operator.latency, 0.99),
        at(delivery, 0.99),
        at(&stops[0], 0.99),
        at(&stops[1], 0.5),
        at(&stops[1], 0.99),
        at(&stops[1], 1.0),
    );
    if *refused != (0, 0) {
        println!("        the operator was refused {} commands, the controller {} calls", refused.0, refused.1);
    }
    for (reason, count) in &flood.refused {
        println!("        {count:9} {reason}");
    }
}

fn json(Outcome { multiple, flood, operator, delivery, control, stops, renewals, refused }: &Outcome) -> Value {
    json!({
        "multiple": multiple, "sent": flood.sent, "seconds": flood.seconds, "accepted": flood.accepted.len(),
        "refused": flood.refused, "accepted_ms": percentiles(&flood.accepted), "control_ms": percentiles(&control.latency),
        "control_over_flooding_stream_ms": percentiles(&renewals.latency),
        "operator_ms": percentiles(&operator.latency), "operator_hz": operator.achieved_hz,
        "delivery_ms": percentiles(delivery), "stops": stops[0].len(), "stop_ms": percentiles(&stops[0]),
        "stop_heard_ms": percentiles(&stops[1]), "operator_refused": refused.0, "control_refused": refused.1,
    })
}
