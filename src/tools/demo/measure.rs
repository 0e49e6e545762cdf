//! Figures of the demo.

use super::graph::Received;
use super::user::User;
use hdrhistogram::Histogram;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Longest latency that is told apart, an hour.
const MICROSECONDS_MAX: u64 = 3_600_000_000;

/// Percentiles of a latency in milliseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Percentiles {
    /// Half are faster.
    pub p50: f64,
    /// The 95th percentile.
    pub p95: f64,
    /// The 99th percentile.
    pub p99: f64,
    /// The slowest.
    pub max: f64,
}

impl Percentiles {
    fn of(histogram: &Histogram<u64>) -> Self {
        let ms = |micros: u64| micros as f64 / 1000.0;
        Self {
            p50: ms(histogram.value_at_quantile(0.5)),
            p95: ms(histogram.value_at_quantile(0.95)),
            p99: ms(histogram.value_at_quantile(0.99)),
            max: ms(histogram.max()),
        }
    }
}

/// The messages that the robot received in one phase.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Phase {
    /// Messages a second that reached the robot.
    pub robot_hz: f64,
    /// Of Salma.
    pub salma_hz: f64,
    /// Of Farhad.
    pub farhad_hz: f64,
    /// Messages of somebody who had no right to publish.
    pub intruder_messages: u64,
}

impl Phase {
    /// Counts what came in `duration`; `intruder` is who may not publish in this phase.
    pub(super) fn count(received: &[Received], duration: Duration, intruder: Option<User>) -> Self {
        let of = |operator| received.iter().filter(|message| message.operator == Some(operator)).count();
        let hz = |count: usize| count as f64 / duration.as_secs_f64();
        let (salma, farhad) = (of(User::Salma), of(User::Farhad));
        Self {
            robot_hz: hz(salma + farhad),
            salma_hz: hz(salma),
            farhad_hz: hz(farhad),
            intruder_messages: intruder.map_or(0, |intruder| of(intruder) as u64),
        }
    }
}

/// Collects the time from the operator's publication to the robot's reception.
#[derive(Default)]
pub struct RosToRos {
    microseconds: Vec<u64>,
}

impl RosToRos {
    /// Adds the messages of one operator, published from number `first` on at `times`.
    pub fn add(&mut self, operator: User, first: usize, times: &[Instant], received: &[Received]) {
        for message in received.iter().filter(|message| message.operator == Some(operator)) {
            if let Some(published) = message.number.checked_sub(first).and_then(|index| times.get(index)) {
                let latency = message.at.saturating_duration_since(*published);
                self.microseconds.push(u64::try_from(latency.as_micros()).unwrap_or(u64::MAX));
            }
        }
    }

    /// The number of messages.
    pub fn count(&self) -> usize {
        self.microseconds.len()
    }

    /// The percentiles so far; zeros if nothing was received.
    pub fn percentiles(&self) -> Percentiles {
        let Ok(mut histogram) = Histogram::new_with_bounds(1, MICROSECONDS_MAX, 3) else {
            return Percentiles::default();
        };
        for value in &self.microseconds {
            histogram.saturating_record(*value);
        }
        Percentiles::of(&histogram)
    }
}
