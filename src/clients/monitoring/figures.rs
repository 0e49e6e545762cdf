//! Figures of `/metrics`, as pages register them.

use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::registry::{Registry, Unit};
use std::sync::atomic::AtomicU64;
use std::time::Duration;

/// Labels with their values.
pub(super) type Labels = Vec<(&'static str, String)>;
/// Figures of several things.
pub(super) type Several = Family<Labels, Gauge<f64, AtomicU64>>;

/// A figure without a unit.
pub(super) fn number(registry: &mut Registry, name: &str, help: &str, value: u64) {
    registry.register(name, help, ConstGauge::new(value));
}

/// A time in seconds.
pub(super) fn seconds(registry: &mut Registry, name: &str, help: &str, value: f64) {
    registry.register_with_unit(name, help, Unit::Seconds, ConstGauge::new(value));
}

/// A time that only grows, in seconds; the name gets `_total`.
pub(super) fn seconds_in_all(registry: &mut Registry, name: &str, help: &str, value: Duration) {
    registry.register_with_unit(name, help, Unit::Seconds, ConstCounter::new(value.as_secs_f64()));
}

/// A size in bytes.
pub(super) fn bytes(registry: &mut Registry, name: &str, help: &str, value: u64) {
    registry.register_with_unit(name, help, Unit::Bytes, ConstGauge::new(value));
}

/// Counts of several things; the name gets `_total`.
pub(super) fn counts(registry: &mut Registry, name: &str, help: &str, each: impl Iterator<Item = (Labels, u64)>) {
    let all = Family::<Labels, Counter>::default();
    for (labels, count) in each {
        all.get_or_create(&labels).inc_by(count);
    }
    registry.register(name, help, all);
}

/// Figures of several things, without a unit.
pub(super) fn numbers(registry: &mut Registry, name: &str, help: &str, each: impl Iterator<Item = (Labels, u64)>) {
    let all = Several::default();
    for (labels, value) in each {
        all.get_or_create(&labels).set(value as f64);
    }
    registry.register(name, help, all);
}
