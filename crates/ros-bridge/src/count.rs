//! The counters of a route: kept while it runs, summed up when it ends.

mod spread;

pub use self::spread::{BOUNDS_US, Spread};

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use ledger_base::costly_invariant;
use ledger_base::rejection::{Code, Rejection};
use ledger_traces::Tracer;
use serde::Serialize;

use crate::{config::RouteConfig, dds::Matched, door::Door, gateway::Tally};

/// Longest latency told apart, in microseconds.
const LATENCY_US_MAX: u64 = 60_000_000;
/// The same complaint is logged at most this often.
const COMPLAINT_EVERY: Duration = Duration::from_secs(10);

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
    /// 95 of 100 are at most this.
    pub p95: u64,
    /// 99 of 100 are at most this.
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
    door: Option<Arc<Door>>,
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
    pub(crate) fn new(route: &RouteConfig) -> Self {
        let summary = RouteSummary {
            service: route.service.clone(),
            direction: route.kind.name,
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

    /// The route has been opened.
    pub(crate) fn opened(&self, matched: &Matched, door: Option<Arc<Door>>) {
        let mut counts = self.lock();
        let before = counts.ends.replace(Ends { matched: matched.clone(), door });
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
        self.door.as_ref().map_or(0, |door| door.returned())
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

/// Decides what is worth a line in the log: a reason that is new, or the same again after a while.
#[derive(Debug, Default)]
pub(crate) struct Complaint {
    /// When each reason was last told, and how often it was not since then. The program has a few reasons.
    told: BTreeMap<&'static str, (Instant, u64)>,
}

impl Complaint {
    /// Is it worth a line? Then with the number of those for the same reason that were not.
    pub(crate) fn worth(&mut self, name: &'static str, now: Instant) -> Option<u64> {
        let Some((told, silent)) = self.told.get_mut(name) else {
            self.told.insert(name, (now, 0));
            return Some(0);
        };
        if now.saturating_duration_since(*told) < COMPLAINT_EVERY {
            *silent = silent.saturating_add(1);
            return None;
        }
        *told = now;
        Some(std::mem::take(silent))
    }
}

/// Code and reason of a refusal in one line.
pub(crate) fn line(refused: &Rejection) -> String {
    let Rejection { code, message, found, wanted, .. } = refused;
    let detail = |label: &str, text: &str| if text.is_empty() { String::new() } else { format!("; {label} {text}") };
    costly_invariant!(*code != Code::Ok, "a refusal has a code", "{message}");
    format!("{code} {message}{}{}", detail("found", found), detail("wanted", wanted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_complaint_is_repeated_after_a_while_only() {
        let (mut complaint, start) = (Complaint::default(), Instant::now());
        assert_eq!(complaint.worth("HELD", start), Some(0));
        assert_eq!(complaint.worth("HELD", start + Duration::from_secs(1)), None);
        assert_eq!(complaint.worth("HELD", start + Duration::from_secs(2)), None);
        assert_eq!(complaint.worth("HELD", start + Duration::from_secs(11)), Some(2));
        assert_eq!(complaint.worth("NOT_HOLDER", start + Duration::from_secs(11)), Some(0));
    }

    #[test]
    fn reasons_in_turn_are_told_once_each_and_not_with_every_sample() {
        let (mut complaint, start) = (Complaint::default(), Instant::now());
        let told = (0..1000).filter(|number| {
            let name = if number % 2 == 0 { "BAD_MESSAGE" } else { "NOT_HOLDER" };
            complaint.worth(name, start + Duration::from_millis(*number)).is_some()
        });
        assert_eq!(told.count(), 2);
        assert_eq!(complaint.worth("NOT_HOLDER", start + COMPLAINT_EVERY * 2), Some(499));
    }
}
