//! `simulate`: runs seeds until the time is up, and reports broken promises and what was covered.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a command-line program")]

use clap::Parser;
use ledgerd_sim::people::People;
use ledgerd_sim::seeds::{Liars, Simulation, Storms, all, explain};
use ledgerd_sim::twins::Cast;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Exit code of a run in which a promise was broken.
const BROKEN: u8 = 1;
/// Exit code of a run of many seeds in which some kind of fault never happened: it proves less than it seems to.
const INCOMPLETE: u8 = 3;
/// A line of progress after this many seeds.
const PROGRESS: u64 = 100;

/// Simulates a cluster under faults, seed by seed.
#[derive(Parser)]
#[command(name = "simulate")]
struct Arguments {
    /// Run for this many hours of real time.
    #[arg(long, conflicts_with_all = ["seeds", "seed"])]
    hours: Option<f64>,
    /// Run this many seeds, on all processors.
    #[arg(long, conflicts_with = "seed")]
    seeds: Option<u64>,
    /// Run this one seed.
    #[arg(long)]
    seed: Option<u64>,
    /// The first seed of a run of many.
    #[arg(long, default_value_t = 0)]
    from: u64,
    /// Print everything that happens.
    #[arg(long)]
    trace: bool,
    /// Run networks in which organisations lie with all their nodes, also as leaders.
    #[arg(long)]
    liars: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    if arguments.liars {
        simulate(&Liars(Arc::new(Cast::new())), &arguments)
    } else {
        simulate(&Storms(Arc::new(People::new())), &arguments)
    }
}

fn simulate<S: Simulation>(simulation: &S, arguments: &Arguments) -> ExitCode {
    if let Some(seed) = arguments.seed {
        let report = simulation.run(seed, arguments.trace);
        println!("{}", report.trace.as_deref().unwrap_or_default());
        println!("seed {seed}, trace {:016x}\n{}", report.trace_hash, report.counts);
        let violation = explain::<S>(&report);
        return violation.map_or(ExitCode::SUCCESS, |violation| {
            println!("{violation}");
            ExitCode::from(BROKEN)
        });
    }
    let until = arguments.hours.map(|hours| Instant::now() + Duration::from_secs_f64(hours * 3600.0));
    let seeds = arguments.seeds.unwrap_or(if arguments.hours.is_some() { u64::MAX } else { 100 });
    let (run, broken) = (AtomicU64::new(0), AtomicBool::new(false));
    let counts = all(simulation, arguments.from, seeds, until, |report| {
        if let Some(violation) = explain::<S>(report) {
            println!("{violation}");
            broken.store(true, Ordering::Relaxed);
        }
        let run = run.fetch_add(1, Ordering::Relaxed) + 1;
        if run.is_multiple_of(PROGRESS) {
            eprintln!("{run} seeds");
        }
        true
    });
    println!("{counts}");
    let missing = S::missing(&counts);
    if !missing.is_empty() {
        println!("never happened: {}", missing.join(", "));
    }
    match () {
        () if broken.into_inner() => ExitCode::from(BROKEN),
        () if S::is_enough(&counts) && !missing.is_empty() => ExitCode::from(INCOMPLETE),
        () => ExitCode::SUCCESS,
    }
}
