//! Runs seeds, one on each processor at a time, and adds up what happened in them.

use crate::coverage::Coverage;
use crate::invariant::{Check, Violation};
use crate::people::People;
use crate::twins::{self, Cast, Counts};
use std::fmt::Display;
use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// The outcome of a seed.
pub struct Report<C> {
    /// The seed.
    pub seed: u64,
    /// The promise that was broken, if one was.
    pub violation: Option<Violation>,
    /// The deeds.
    pub counts: C,
    /// Hash over the trace.
    pub trace_hash: u64,
    /// The trace, if it was asked for.
    pub trace: Option<String>,
}

/// One of the simulations.
pub trait Simulation: Sync {
    /// The deeds in a seed, to be added up.
    type Counts: Default + Display + Send;
    /// How `simulate` is called for it, before the seed.
    const ARGUMENTS: &'static str;

    /// Runs one seed.
    fn run(&self, seed: u64, keep_trace: bool) -> Report<Self::Counts>;
    /// Adds the deeds of another seed.
    fn add(all: &mut Self::Counts, one: &Self::Counts);
    /// The deeds that never happened, though every run of many seeds should have them.
    fn missing(all: &Self::Counts) -> Vec<String>;
    /// Were there enough seeds for everything to happen?
    fn is_enough(all: &Self::Counts) -> bool;
    /// Seeds so far, and the virtual time in microseconds.
    fn length(all: &Self::Counts) -> (u64, u64);
}

/// Everything fails but the people, and single nodes lie.
pub struct Storms(pub Arc<People>);

/// Organisations lie with all their nodes, also as leaders.
pub struct Liars(pub Arc<Cast>);

impl Simulation for Storms {
    type Counts = Coverage;
    const ARGUMENTS: &'static str = "";

    fn run(&self, seed: u64, keep_trace: bool) -> Report<Coverage> {
        crate::run::run(seed, &self.0, keep_trace)
    }

    fn add(all: &mut Coverage, one: &Coverage) {
        all.add(one);
    }

    fn missing(all: &Coverage) -> Vec<String> {
        all.missing()
    }

    fn is_enough(all: &Coverage) -> bool {
        all.is_enough()
    }

    fn length(all: &Coverage) -> (u64, u64) {
        (all.seeds, all.time)
    }
}

impl Simulation for Liars {
    type Counts = Counts;
    const ARGUMENTS: &'static str = "--liars ";

    fn run(&self, seed: u64, keep_trace: bool) -> Report<Counts> {
        twins::run(seed, &self.0, keep_trace)
    }

    fn add(all: &mut Counts, one: &Counts) {
        all.add(one);
    }

    fn missing(all: &Counts) -> Vec<String> {
        all.missing().into_iter().map(str::to_owned).collect()
    }

    fn is_enough(all: &Counts) -> bool {
        all.is_enough()
    }

    fn length(all: &Counts) -> (u64, u64) {
        (all.seeds, all.time)
    }
}

/// Every sixteenth seed shares no results, so that a function whose answer differs from node to node is noticed.
const UNSHARED_EVERY: u64 = 16;

/// The broken promise of a seed, if there is one: a panic of the product is one like any other. Costly invariants are checked, and in
/// most seeds the nodes share the results of pure functions.
pub fn violation(seed: u64, play: impl FnOnce() -> Check) -> Option<Violation> {
    ledger_base::invariant::look_closely();
    ledger_base::shared_results::share(!seed.is_multiple_of(UNSHARED_EVERY));
    match catch_unwind(AssertUnwindSafe(play)) {
        Ok(check) => check.err(),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("something");
            Some(Violation::new("no panic", text))
        }
    }
}

/// The violation of a report in words, and how to see it again.
pub fn explain<S: Simulation>(report: &Report<S::Counts>) -> Option<String> {
    let violation = report.violation.as_ref()?;
    let (seed, arguments) = (report.seed, S::ARGUMENTS);
    Some(format!(
        "seed {seed} breaks a promise: {violation}\n  repeat it:  cargo run --release --bin simulate -- {arguments}--seed {seed} --trace"
    ))
}

/// Runs the seeds `from`, `from + 1`, …, as many as there are or until the time is up, and adds them. `see` gets each report in the
/// thread that ran it; the rest is not run where it answers `false`.
pub fn all<S: Simulation>(
    simulation: &S,
    from: u64,
    seeds: u64,
    until: Option<Instant>,
    see: impl Fn(&Report<S::Counts>) -> bool + Sync,
) -> S::Counts {
    let (next, ended) = (AtomicU64::new(0), AtomicBool::new(false));
    let worker = || {
        let mut all = S::Counts::default();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let is_late = until.is_some_and(|until| Instant::now() >= until);
            if at >= seeds || is_late || ended.load(Ordering::Relaxed) {
                return all;
            }
            let report = simulation.run(from.saturating_add(at), false);
            S::add(&mut all, &report.counts);
            if !see(&report) {
                ended.store(true, Ordering::Relaxed);
            }
        }
    };
    let mut all = S::Counts::default();
    std::thread::scope(|scope| {
        let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
        let workers: Vec<_> = (0..processors).map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            S::add(&mut all, &worker.join().unwrap_or_else(|panicked| resume_unwind(panicked)));
        }
    });
    all
}
