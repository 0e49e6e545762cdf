//! Load by the clock: commands at fixed times, whether or not earlier ones are answered.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use hdrhistogram::Histogram;
use std::future::Future;
use std::hint::spin_loop;
use std::thread::sleep;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;
use tokio::sync::mpsc;

/// The operating system wakes a sleeper late by up to about this much; so long is waited without sleeping.
const SPIN: Duration = Duration::from_micros(100);
/// The longest latency that histograms tell apart, in nanoseconds.
const LATENCY_NS_MAX: u64 = 60_000_000_000;

/// The outcome of one run. Latencies are in nanoseconds.
pub(crate) struct Run {
    /// Commands a second that were due.
    pub(crate) hz: f64,
    /// Verdicts a second that came.
    pub(crate) achieved_hz: f64,
    /// From the time a command was *due* until its verdict: what a late sender costs is counted, so one slow answer
    /// cannot hide those behind it (coordinated omission).
    pub(crate) latency: Histogram<u64>,
    /// From the time a command was due until it was signed and handed over.
    pub(crate) sending: Histogram<u64>,
    /// Median latency of the last third of the run, as a multiple of that of the first third.
    pub(crate) growth: f64,
    /// When the first command was due; the others follow every 1/hz.
    pub(crate) start: Instant,
}

struct Sample {
    due: Instant,
    sent: Instant,
    done: Instant,
}

/// Starts `send` at `hz` for `duration`, whether or not earlier ones are done.
pub(crate) fn open_loop<F: Future<Output = ()> + Send + 'static>(
    runtime: &Runtime,
    hz: f64,
    duration: Duration,
    send: impl Fn() -> F,
) -> Run {
    let _context = runtime.enter();
    let (samples, mut done) = mpsc::unbounded_channel();
    let count = (duration.as_secs_f64() * hz).ceil().max(2.0) as u32;
    let start = Instant::now() + Duration::from_millis(10);
    for number in 0..count {
        let due = start + Duration::from_secs_f64(f64::from(number) / hz);
        wait_until(due);
        let verdict = send();
        let sent = Instant::now();
        let samples = samples.clone();
        runtime.spawn(async move {
            verdict.await;
            samples.send(Sample { due, sent, done: Instant::now() }).unwrap();
        });
    }
    drop(samples);
    let mut finished = Vec::new();
    while let Some(sample) = done.blocking_recv() {
        finished.push(sample);
    }
    assert_eq!(finished.len(), count as usize, "a command got no verdict");
    finished.sort_unstable_by_key(|sample| sample.due);
    summarise(hz, start, &finished)
}

/// The outcome of a closed loop.
pub(crate) struct Throughput {
    /// Calls that were under way at any time.
    pub(crate) in_flight: usize,
    /// Calls done a second.
    pub(crate) per_second: f64,
    /// Calls done.
    pub(crate) done: u64,
    /// From a call's start to its end.
    pub(crate) latency: Histogram<u64>,
}

/// Keeps `in_flight` calls under way for `duration`: each is followed by the next as soon as it is done.
pub(crate) fn closed_loop<F: Future<Output = ()> + Send + 'static>(
    runtime: &Runtime,
    in_flight: usize,
    duration: Duration,
    send: impl Fn() -> F + Clone + Send + 'static,
) -> Throughput {
    let start = Instant::now();
    let callers: Vec<_> = (0..in_flight)
        .map(|_| {
            let send = send.clone();
            runtime.spawn(async move {
                let mut times = Vec::new();
                while start.elapsed() < duration {
                    let begin = Instant::now();
                    send().await;
                    times.push(begin.elapsed());
                }
                times
            })
        })
        .collect();
    let times: Vec<_> = callers.into_iter().flat_map(|caller| runtime.block_on(caller).unwrap()).collect();
    let elapsed = start.elapsed().as_secs_f64();
    Throughput {
        in_flight,
        per_second: times.len() as f64 / elapsed,
        done: times.len() as u64,
        latency: histogram(times.into_iter()),
    }
}

/// Calls at `hz` for `duration`, of which each ends before the next is due, or makes it late. Nanoseconds from when it
/// was due.
pub(crate) fn paced(hz: f64, duration: Duration, mut once: impl FnMut()) -> Histogram<u64> {
    let start = Instant::now() + Duration::from_millis(10);
    let count = (duration.as_secs_f64() * hz).ceil() as u32;
    let times = (0..count).map(|number| {
        let due = start + Duration::from_secs_f64(f64::from(number) / hz);
        wait_until(due);
        once();
        due.elapsed()
    });
    histogram(times)
}

/// Sleeps, then spins, until that moment; returns at once if it has passed.
pub(crate) fn wait_until(due: Instant) {
    if let Some(long) = due.saturating_duration_since(Instant::now()).checked_sub(SPIN) {
        sleep(long);
    }
    while Instant::now() < due {
        spin_loop();
    }
}

fn summarise(hz: f64, start: Instant, samples: &[Sample]) -> Run {
    let latencies = |samples: &[Sample]| histogram(samples.iter().map(|sample| sample.done - sample.due));
    let first = samples.iter().map(|sample| sample.done).min().unwrap();
    let last = samples.iter().map(|sample| sample.done).max().unwrap();
    let third = samples.len().div_ceil(3);
    let median = |samples: &[Sample]| latencies(samples).value_at_quantile(0.5) as f64;
    Run {
        hz,
        start,
        achieved_hz: (samples.len() - 1) as f64 / (last - first).as_secs_f64(),
        latency: latencies(samples),
        sending: histogram(samples.iter().map(|sample| sample.sent - sample.due)),
        growth: median(&samples[samples.len() - third..]) / median(&samples[..third]),
    }
}

/// Durations in nanoseconds.
pub(crate) fn histogram(durations: impl Iterator<Item = Duration>) -> Histogram<u64> {
    let mut histogram = Histogram::new_with_max(LATENCY_NS_MAX, 3).unwrap();
    for duration in durations {
        histogram.saturating_record(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX));
    }
    histogram
}
