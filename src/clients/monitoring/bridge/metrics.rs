//! The figures of a bridge: docs/metrics.md describes each.

use crate::clients::monitoring::figures::{Labels, counts, number, numbers, seconds};
use prometheus_client::encoding::{EncodeMetric, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};
use ros_bridge::{BOUNDS_US, RouteSummary, Spread};
use ros_bridge::{BridgeStatus, BridgeView, RouteView};

const MICROS: f64 = 1_000_000.0;

/// A figure of a route.
type Of = fn(&RouteView) -> u64;
/// Its name and its help text.
type Figure = (&'static str, &'static str, Of);

const STATES: [Figure; 5] = [
    ("route_is_open", "1 while the route is open, 0 while it waits", |route| u64::from(route.is_open)),
    ("matched", "Endpoints of other ROS 2 nodes connected to the route", |route| {
        u64::try_from(route.summary.matched).unwrap_or(u64::MAX)
    }),
    ("needs_grant", "1 if publishing on the service needs a grant, 0 otherwise", |route| u64::from(route.needs_grant)),
    ("is_held", "1 while the service has a holder, on a route to the ledger the bridge itself; 0 otherwise", |route| {
        u64::from(route.is_held)
    }),
    ("beside", "Publishers other than the bridge on the topic of a command route", |route| {
        u64::try_from(route.beside).unwrap_or(u64::MAX)
    }),
];

const COUNTS: [Figure; 5] = [
    ("received", "Samples received from the local graph", |route| route.summary.samples_in),
    ("submitted", "Samples submitted to the ledger", |route| route.summary.submitted),
    ("committed", "Samples that the ledger executed", |route| route.summary.committed),
    ("delivered", "Samples published to the local graph", |route| route.summary.published),
    ("clamped", "Samples clamped to the limit of the grant of their creator", |route| route.summary.clamped),
];

/// Registers the figures of a bridge.
pub(crate) fn register(registry: &mut Registry, view: &BridgeView) {
    if let BridgeView::Runs(standing) = view {
        registry.register("bridge", "This bridge", about(standing));
    }
    let registry = registry.sub_registry_with_prefix("bridge");
    let help = "1 while the bridge has joined its graph, 0 while it waits";
    number(registry, "is_running", help, u64::from(matches!(view, BridgeView::Runs(_))));
    if let BridgeView::Runs(standing) = view {
        running(registry, standing);
        routes(registry, &standing.routes);
    }
}

fn about(standing: &BridgeStatus) -> Info<Labels> {
    Info::new(vec![
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("identity", standing.identity.clone()),
        ("domain", standing.domain.to_string()),
    ])
}

fn running(registry: &mut Registry, standing: &BridgeStatus) {
    if let Some(silent) = standing.silent {
        seconds(registry, "ledger_silence", "Time since the last contact with the ledger", silent.as_secs_f64());
    }
}

fn routes(registry: &mut Registry, routes: &[RouteView]) {
    let each = |of: Of| routes.iter().map(move |route| (labels(&route.summary), of(route)));
    for (name, help, of) in STATES {
        numbers(registry, name, help, each(of));
    }
    for (name, help, of) in COUNTS {
        counts(registry, name, help, each(of));
    }
    counts(registry, "dropped", "Samples dropped, by reason", parts(routes, "reason", dropped));
    let help = "Samples rejected, by code";
    counts(registry, "refused", help, parts(routes, "code", |summary| tally(&summary.refused)));
    let help = "Stop messages published, by reason";
    counts(registry, "stops", help, parts(routes, "reason", |summary| tally(&summary.stops)));
    let help = "Time from a received sample to its verdict";
    spreads(registry, "commit", help, routes.iter().map(|route| (labels(&route.summary), route.commit.clone())));
    let help = "Time from the signature of a message to its delivery to the local graph, by the clocks of both \
                machines";
    spreads(registry, "age", help, routes.iter().map(|route| (labels(&route.summary), route.age.clone())));
}

fn labels(summary: &RouteSummary) -> Labels {
    vec![("service", summary.service.clone()), ("direction", summary.direction.to_owned())]
}

/// Counts of routes that have parts, with a label more.
fn parts<'a>(
    routes: &'a [RouteView],
    label: &'static str,
    of: impl Fn(&RouteSummary) -> Vec<(&'static str, u64)> + 'a,
) -> impl Iterator<Item = (Labels, u64)> + 'a {
    routes.iter().flat_map(move |route| {
        let labelled = |(name, count): (&'static str, u64)| {
            let mut labels = labels(&route.summary);
            labels.push((label, name.to_owned()));
            (labels, count)
        };
        of(&route.summary).into_iter().map(labelled).collect::<Vec<_>>()
    })
}

fn tally(tally: &ros_bridge::Tally) -> Vec<(&'static str, u64)> {
    tally.iter().map(|(name, count)| (*name, *count)).collect()
}

/// By the names of the summary, and by the rules of the gate.
fn dropped(summary: &RouteSummary) -> Vec<(&'static str, u64)> {
    let mut all = vec![
        ("replaced", summary.replaced),
        ("thinned", summary.thinned),
        ("withheld", summary.withheld),
        ("returned", summary.returned),
        ("unpublished", summary.unpublished),
    ];
    all.extend(tally(&summary.gate));
    all
}

/// Registers a histogram of several things: of those for which there is anything.
fn spreads(registry: &mut Registry, name: &str, help: &str, each: impl Iterator<Item = (Labels, Spread)>) {
    let some = each.filter(|(_, spread)| spread.count() > 0).collect();
    registry.register_with_unit(name, help, Unit::Seconds, Spreads(some));
}

/// Histograms that were observed elsewhere.
#[derive(Debug)]
struct Spreads(Vec<(Labels, Spread)>);

impl EncodeMetric for Spreads {
    fn encode(&self, mut encoder: MetricEncoder<'_>) -> Result<(), std::fmt::Error> {
        for (labels, Spread { steps, sum_us }) in &self.0 {
            let bounds = BOUNDS_US.iter().map(|bound| *bound as f64 / MICROS).chain([f64::INFINITY]);
            let buckets: Vec<(f64, u64)> = bounds.zip(steps.iter().copied()).collect();
            let count = steps.iter().sum();
            let mut one = encoder.encode_family(labels)?;
            one.encode_histogram::<NoLabelSet>(*sum_us as f64 / MICROS, count, &buckets, None)?;
        }
        Ok(())
    }

    fn metric_type(&self) -> MetricType {
        MetricType::Histogram
    }

    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}
