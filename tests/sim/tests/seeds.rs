//! Many seeds, those that once failed, and the same seed twice.

#![expect(clippy::panic, clippy::print_stderr, reason = "tests")]

use ledgerd_sim::people::People;
use ledgerd_sim::run::run;
use ledgerd_sim::seeds::{Report, Simulation, Storms, all, explain};
use std::sync::Arc;

/// Seeds of one test run; `LEDGER_SIM_SEEDS` runs more.
const SEEDS: u64 = 16;
/// Seeds of `./test --long`.
const SEEDS_LONG: u64 = 2000;
/// Those that once failed.
const REGRESSIONS: &str = include_str!("../regressions-storms.txt");

/// Runs seeds, of which none may break a promise: as many as the variable says, more with `--long`.
pub(crate) fn hold<S: Simulation>(simulation: &S, variable: &str, seeds: u64, seeds_long: u64) -> S::Counts {
    let given = std::env::var(variable).ok().and_then(|seeds| seeds.parse().ok());
    let is_long = std::env::var_os("LEDGERD_TEST_LONG").is_some();
    let seeds = given.unwrap_or(if is_long { seeds_long } else { seeds });
    let counts = all(simulation, 0, seeds, None, holds::<S>);
    eprintln!("{counts}");
    let missing = S::missing(&counts);
    eprintln!("never happened: {missing:?}");
    assert!(missing.is_empty() || !S::is_enough(&counts), "in {seeds} seeds never happened: {missing:?}");
    counts
}

/// Runs the seeds of a list, of which none may break a promise any more.
pub(crate) fn hold_again<S: Simulation>(simulation: &S, list: &str) {
    for line in list.lines().filter(|line| !line.starts_with('#')) {
        let seed = line.split_whitespace().next().and_then(|seed| seed.parse().ok());
        let seed = seed.unwrap_or_else(|| panic!("no seed in {line:?}"));
        holds::<S>(&simulation.run(seed, false));
    }
}

fn holds<S: Simulation>(report: &Report<S::Counts>) -> bool {
    if let Some(violation) = explain::<S>(report) {
        panic!("{violation}");
    }
    true
}

#[test]
fn no_storm_breaks_a_promise_and_every_kind_of_fault_has_happened() {
    hold(&Storms(Arc::new(People::new())), "LEDGER_SIM_SEEDS", SEEDS, SEEDS_LONG);
}

#[test]
fn what_once_failed_does_not_fail_again() {
    hold_again(&Storms(Arc::new(People::new())), REGRESSIONS);
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
