//! Many seeds, those that once failed, and the same seed twice.

#![expect(clippy::panic, clippy::print_stderr, reason = "tests")]

use ledgerd_sim::coverage::Coverage;
use ledgerd_sim::people::People;
use ledgerd_sim::run::run;
use std::num::NonZero;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Seeds of one test run; `LEDGER_SIM_SEEDS` runs more.
const SEEDS: u64 = 60;
/// Seeds of `./test --long`.
const SEEDS_LONG: u64 = 2000;
/// Those that once failed.
const REGRESSIONS: &str = include_str!("../regressions.txt");

fn holds(seed: u64, people: &Arc<People>) -> Coverage {
    let report = run(seed, people, false);
    if let Some(violation) = report.violation {
        panic!("{violation}\n  repeat it:  cargo run --release --bin simulate -- --seed {seed} --trace");
    }
    report.coverage
}

/// Runs so many seeds, one on each processor at a time, and says how much they covered.
fn all(seeds: u64, people: &Arc<People>) -> Coverage {
    let next = AtomicU64::new(0);
    let worker = || {
        let mut covered = Coverage::default();
        loop {
            match next.fetch_add(1, Ordering::Relaxed) {
                seed if seed < seeds => covered.add(&holds(seed, people)),
                _ => return covered,
            }
        }
    };
    let mut covered = Coverage::default();
    std::thread::scope(|scope| {
        let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
        let workers: Vec<_> = (0..processors).map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            covered.add(&worker.join().unwrap_or_else(|panicked| std::panic::resume_unwind(panicked)));
        }
    });
    covered
}

#[test]
fn no_storm_breaks_a_promise_and_every_kind_of_fault_has_happened() {
    let people = Arc::new(People::new());
    let seeds = std::env::var("LEDGER_SIM_SEEDS").ok().and_then(|seeds| seeds.parse().ok());
    let seeds = seeds.unwrap_or(if std::env::var_os("LEDGERD_TEST_LONG").is_some() { SEEDS_LONG } else { SEEDS });
    let covered = all(seeds, &people);
    eprintln!("{covered}");
    let missing = covered.missing();
    eprintln!("never happened: {missing:?}");
    assert!(missing.is_empty() || !covered.is_enough(), "in {seeds} seeds never happened: {missing:?}");
}

#[test]
fn what_once_failed_does_not_fail_again() {
    let people = Arc::new(People::new());
    for line in REGRESSIONS.lines().filter(|line| !line.starts_with('#')) {
        let seed = line.split_whitespace().next().and_then(|seed| seed.parse().ok());
        let seed = seed.unwrap_or_else(|| panic!("regressions.txt: no seed in {line:?}"));
        holds(seed, &people);
    }
}

#[test]
fn the_same_seed_gives_the_same_trace_byte_for_byte() {
    let people = Arc::new(People::new());
    for seed in [3, 11] {
        let (one, other) = (run(seed, &people, true).trace, run(seed, &Arc::new(People::new()), true).trace);
        assert!(one == other, "seed {seed} gave two traces");
        assert!(one.is_some_and(|text| text.len() > 10_000));
    }
    assert_ne!(run(3, &people, false).trace_hash, run(4, &people, false).trace_hash);
}
