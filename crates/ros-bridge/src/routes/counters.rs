//! The counters of a route: kept while it runs, summed up when it ends.

mod spread;

pub use self::spread::{BOUNDS_US, Spread};

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use ledger_traces::Tracer;
use serde::Serialize;

use crate::graph::{dds::Matched, loop_filter::LoopFilter};

/// Longest latency told apart, in microseconds.
const LATENCY_US_MAX: u64 = 60_000_000;

/// How often something happened, by its name.
pub type Tally = BTreeMap<&'static str, u64>;

/// The counters of a route so far.
#[derive(Clone, Debug, Serialize)]
pub struct RouteSummary {
    /// The service.
    pub service: String,
    /// The kind of the route by its name in the configuration.
    pub direction: &'static str,
    /// The reason why the route is not open: code and message.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub waiting: Option<String>,
    /// Publishers or subscribers of other ROS 2 nodes that this route is connected with now.
    pub matched: usize,
    /// Samples taken in from the local graph.
    pub samples_in: u64,
    /// Samples that newer ones replaced while they waited, or that were too large.
    pub replaced: u64,
    /// Samples that newer ones replaced because of the route's `max_rate_hz`.
    pub thinned: u64,
    /// Samples of a discovered route that were kept back, because the bridge's user did not hold the service.
    pub withheld: u64,
    /// Samples that came from the ledger, and were not taken in again.
    pub returned: u64,
    /// Samples submitted to the ledger.
    pub submitted: u64,
    /// Samples that the ledger executed.
    pub committed: u64,
    /// Samples that were refused, by the name of the code.
    pub refused: Tally,
    /// Samples published to the local graph.
    pub published: u64,
    /// Samples that the gate slowed down to the limit of their creator's grant.
    pub clamped: u64,
    /// Samples that the local graph did not take, because a reader does not keep up.
    pub unpublished: u64,
    /// Stop messages published, by reason.
    pub stops: Tally,
    /// Messages that the gate did not let pass, and samples that were dropped on their way to the ledger, by reason.
    pub gate: Tally,
    /// From a sample taken in to its verdict, in microseconds.
    pub commit_us: Latency,
}

/// Latencies in microseconds; all zero if there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Latency {
    /// How many were measured.
    pub count: u64,
    /// Half are at most this.
    pub p50: u64,
    /// The 95th percentile.
    pub p95: u64,
    /// The 99th percentile.
    pub p99: u64,
    /// The largest.
    pub max: u64,
}

/// The counters of a route, shared with whoever asks for a summary.
#[derive(Clone, Debug)]
pub(crate) struct Counters {
    counts: Arc<Mutex<Counts>>,
    /// Where the steps of its messages are told.
    pub(crate) tracer: Tracer,
}

/// The counters.
#[derive(Debug)]
pub(crate) struct Counts {
    pub(crate) summary: RouteSummary,
    pub(crate) live: Live,
    latency: Option<Histogram<u64>>,
    /// From a sample taken in to its verdict.
    pub(crate) commit: Spread,
    /// From the signature of a message to its way to the local graph.
    pub(crate) age: Spread,
    ends: Option<Ends>,
}

/// The two ends of an open route, which count by themselves.
#[derive(Debug)]
struct Ends {
    matched: Matched,
    filter: Option<Arc<LoopFilter>>,
}

/// The last events on a route, and its present state.
#[derive(Debug, Default)]
pub(crate) struct Live {
    /// The node gave a sign of life.
    pub(crate) heard: Option<Instant>,
    /// A sample came from the local graph, or a message from the ledger.
    pub(crate) came: Option<Instant>,
    /// A sample was committed, or published.
    pub(crate) passed: Option<Instant>,
    /// The last refusal: code or rule by its name, and what to tell people.
    pub(crate) refused: Option<(&'static str, String, Instant)>,
    /// Does publishing need a grant?
    pub(crate) needs_grant: bool,
    /// Does somebody hold the service? Where samples go to the ledger: the bridge's own user.
    pub(crate) held: bool,
    /// The holders by name, `Org1/Salma`, with commas between; empty if there are none.
    pub(crate) holder: String,
    /// Publishers of others on the topic of a route that delivers commands there.
    pub(crate) beside: usize,
    /// The condition that the route waits for, before anything can pass.
    pub(crate) waiting: Option<String>,
}

impl Counters {
    pub(crate) fn new(service: &str, direction: &'static str) -> Self {
        let summary = RouteSummary {
            service: service.to_owned(),
            direction,
            waiting: None,
            matched: 0,
            samples_in: 0,
            replaced: 0,
            thinned: 0,
            withheld: 0,
            returned: 0,
            submitted: 0,
            committed: 0,
            refused: Tally::new(),
            published: 0,
            clamped: 0,
            unpublished: 0,
            stops: Tally::new(),
            gate: Tally::new(),
            commit_us: Latency::default(),
        };
        let latency = Histogram::new_with_bounds(1, LATENCY_US_MAX, 3).ok();
        let (commit, age) = (Spread::default(), Spread::default());
        let counts = Counts { summary, live: Live::default(), latency, commit, age, ends: None };
        Self { counts: Arc::new(Mutex::new(counts)), tracer: Tracer::default() }
    }

    /// The same, with the steps of its messages told there.
    pub(crate) fn traced(self, tracer: Tracer) -> Self {
        Self { tracer, ..self }
    }

    /// Counters of their own for the other half of the route, with the same tracer.
    pub(crate) fn apart(&self) -> Self {
        let counts = self.lock();
        Self::new(&counts.summary.service, counts.summary.direction).traced(self.tracer.clone())
    }

    /// The route has been opened.
    pub(crate) fn opened(&self, matched: &Matched, filter: Option<Arc<LoopFilter>>) {
        let mut counts = self.lock();
        let before = counts.ends.replace(Ends { matched: matched.clone(), filter });
        counts.summary.returned += before.map_or(0, |ends| ends.returned());
        counts.live = Live::default();
    }

    /// The route has another endpoint in the local graph now.
    pub(crate) fn opened_again(&self, matched: &Matched) {
        if let Some(ends) = &mut self.lock().ends {
            ends.matched = matched.clone();
        }
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The endpoints of others, to wait for them.
    #[cfg(test)]
    pub(crate) fn matched(&self) -> Option<Matched> {
        self.lock().ends.as_ref().map(|ends| ends.matched.clone())
    }

    pub(crate) fn summary(&self) -> RouteSummary {
        let counts = self.lock();
        let mut summary = counts.summary.clone();
        if let Some(ends) = &counts.ends {
            summary.matched = ends.matched.now().matched;
            summary.returned += ends.returned();
        }
        if let Some(latency) = &counts.latency {
            summary.commit_us = Latency {
                count: latency.len(),
                p50: latency.value_at_quantile(0.50),
                p95: latency.value_at_quantile(0.95),
                p99: latency.value_at_quantile(0.99),
                max: latency.max(),
            };
        }
        summary
    }
}

impl Ends {
    fn returned(&self) -> u64 {
        self.filter.as_ref().map_or(0, |filter| filter.returned())
    }
}

impl Counts {
    /// A sample was committed after this long.
    pub(crate) fn committed(&mut self, after: Duration) {
        self.summary.committed += 1;
        self.live.passed = Some(Instant::now());
        let micros = u64::try_from(after.as_micros()).unwrap_or(LATENCY_US_MAX).clamp(1, LATENCY_US_MAX);
        if let Some(latency) = &mut self.latency {
            latency.saturating_record(micros);
        }
        self.commit.observe(micros);
    }
}

/// Adds to a tally.
pub(crate) fn count(tally: &mut Tally, name: &'static str, times: u64) {
    let entry = tally.entry(name).or_default();
    *entry = entry.saturating_add(times);
}
