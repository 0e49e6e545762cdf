//! `simulate`: runs seeds until something breaks or the time is up, and says what was covered.

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a command-line program")]

use clap::Parser;
use ledgerd_sim::coverage::Coverage;
use ledgerd_sim::people::People;
use ledgerd_sim::run::{Report, run};
use ledgerd_sim::twins::{self, Cast};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Exit code of a run in which a promise was broken.
const BROKEN: u8 = 1;
/// Exit code of a run of many seeds in which some kind of fault never happened: it proves less than it seems to.
const INCOMPLETE: u8 = 3;

/// Simulates a cluster under faults, seed by seed.
#[derive(Parser)]
#[command(name = "simulate")]
struct Arguments {
    /// Run for so many hours of real time.
    #[arg(long, conflicts_with_all = ["seeds", "seed"])]
    hours: Option<f64>,
    /// Run so many seeds.
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
        return lie(&arguments);
    }
    let people = Arc::new(People::new());
    let mut covered = Coverage::default();
    if let Some(seed) = arguments.seed {
        let report = run(seed, &people, arguments.trace);
        println!("{}", report.trace.as_deref().unwrap_or_default());
        println!("seed {seed}, trace {:016x}\n{}", report.trace_hash, report.coverage);
        return verdict(&report);
    }
    let until = Duration::from_secs_f64(arguments.hours.unwrap_or(f64::from(u32::MAX)) * 3600.0);
    let seeds = arguments.seeds.unwrap_or(if arguments.hours.is_some() { u64::MAX } else { 100 });
    let (begun, mut told) = (Instant::now(), Instant::now());
    let mut exit = ExitCode::SUCCESS;
    for seed in (arguments.from..).take(usize::try_from(seeds).unwrap_or(usize::MAX)) {
        if begun.elapsed() > until {
            break;
        }
        let report = run(seed, &people, false);
        covered.add(&report.coverage);
        if report.violation.is_some() {
            exit = verdict(&report);
        }
        if told.elapsed() > Duration::from_secs(60) {
            told = Instant::now();
            eprintln!("{} seeds, {} virtual minutes", covered.seeds, covered.time / 60_000_000);
        }
    }
    println!("{covered}");
    let missing = covered.missing();
    if !missing.is_empty() {
        println!("never happened: {}", missing.join(", "));
    }
    if exit == ExitCode::SUCCESS && covered.is_enough() && !missing.is_empty() {
        return ExitCode::from(INCOMPLETE);
    }
    exit
}

/// The same with liars.
fn lie(arguments: &Arguments) -> ExitCode {
    let cast = Arc::new(Cast::new());
    let (mut counts, mut exit) = (twins::Counts::default(), ExitCode::SUCCESS);
    let until = Duration::from_secs_f64(arguments.hours.unwrap_or(f64::from(u32::MAX)) * 3600.0);
    let seeds = arguments.seeds.unwrap_or(if arguments.hours.is_some() { u64::MAX } else { 100 });
    let (first, seeds) = arguments.seed.map_or((arguments.from, seeds), |seed| (seed, 1));
    let (begun, mut told) = (Instant::now(), Instant::now());
    for seed in (first..).take(usize::try_from(seeds).unwrap_or(usize::MAX)) {
        if begun.elapsed() > until {
            break;
        }
        let report = twins::run(seed, &cast, arguments.trace);
        counts.add(&report.counts);
        if let Some(text) = &report.trace {
            println!("{text}");
        }
        if let Some(violation) = &report.violation {
            println!("seed {seed} breaks a promise: {violation}");
            println!("  repeat it:  cargo run --release --bin simulate -- --liars --seed {seed} --trace");
            exit = ExitCode::from(BROKEN);
        }
        if told.elapsed() > Duration::from_secs(60) {
            told = Instant::now();
            eprintln!("{} seeds, {} virtual minutes", counts.seeds, counts.time / 60_000_000);
        }
    }
    println!("{counts}");
    let missing = counts.missing();
    if !missing.is_empty() {
        println!("never happened: {}", missing.join(", "));
    }
    exit
}

/// Says what was broken, and how to see it again.
fn verdict(report: &Report) -> ExitCode {
    let Some(violation) = &report.violation else { return ExitCode::SUCCESS };
    println!("seed {} breaks a promise: {violation}", report.seed);
    println!("  repeat it:  cargo run --release --bin simulate -- --seed {} --trace", report.seed);
    ExitCode::from(BROKEN)
}
