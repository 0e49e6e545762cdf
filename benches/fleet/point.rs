//! One measurement: so many of something, at one rate.

use crate::Bench;
use crate::drivers::Drivers;
use crate::load::{Run, histogram, open_loop};
use crate::network::{Arrivals, Network};
use crate::report::percentiles;
use crate::usage;
use hdrhistogram::Histogram;
use serde_json::{Value, json};
use std::thread::sleep;
use std::time::Duration;

/// Rate and length of what runs before each measurement, so that caches are warm and queues empty.
const WARM_UP: (f64, Duration) = (200.0, Duration::from_millis(300));
/// Time in which a node has stored results and world state.
const STORED_WITHIN: Duration = Duration::from_millis(700);

/// The load that drives a point.
pub(crate) struct Load {
    /// As it is called in results.
    pub(crate) name: String,
    /// Transactions a second.
    pub(crate) hz: f64,
    /// Messages of each.
    pub(crate) messages: usize,
    /// Is a transaction the same whatever the number? Only then there can be a law.
    pub(crate) comparable: bool,
}

impl Load {
    /// One message in each transaction.
    pub(crate) fn hz(hz: f64) -> Self {
        Self { name: format!("{hz} Hz"), hz, messages: 1, comparable: true }
    }
}

/// The measurement. Times are in nanoseconds.
pub(crate) struct Point {
    /// How many of what grows.
    pub(crate) x: f64,
    /// The load that drove it.
    pub(crate) load: Load,
    run: Run,
    delivery: Histogram<u64>,
    /// CPU of all nodes for a transaction, microseconds; their idle work is in it.
    pub(crate) cpu_us: f64,
    /// Resident memory of a node, the mean of all, MiB.
    pub(crate) resident_mib: f64,
    /// The growth of the first node's files for a transaction, bytes, without the zeros that are written ahead.
    pub(crate) disk_bytes: f64,
    /// Further facts, for programs.
    pub(crate) more: Value,
}

impl Point {
    /// Drives a network and measures it; the drivers' messages must be what `arrivals` hears of.
    pub(crate) fn measure(
        bench: &Bench,
        network: &Network,
        drivers: &Drivers,
        arrivals: &Arrivals,
        x: usize,
        load: Load,
    ) -> Self {
        let commands = |hz, messages, duration| {
            open_loop(&bench.runtime, hz, duration, || {
                let verdict = drivers.command(messages);
                async move { drop(verdict.await.unwrap()) }
            })
        };
        commands(WARM_UP.0, load.messages, WARM_UP.1.min(bench.duration));
        let processes = network.processes();
        let disk = || {
            if !bench.smoke {
                sleep(STORED_WITHIN);
            }
            network.directories().next().map_or(0, usage::filled)
        };
        let (first_seq, disk_before) = (drivers.next_seq(), disk());
        let cpu_before = usage::cpu_exact(&processes);
        let run = commands(load.hz, load.messages, bench.duration);
        let cpu = usage::cpu_exact(&processes).saturating_sub(cpu_before);
        let count = run.latency.len();
        let due = |number: u64| run.start + Duration::from_secs_f64(number as f64 / run.hz);
        let arrived = |number: u64| arrivals.of(first_seq + number * load.messages as u64);
        let delivery = histogram((0..count).map(|number| arrived(number) - due(number)));
        let resident: u64 = processes.iter().map(|process| usage::resident(*process)).sum();
        let point = Self {
            x: x as f64,
            delivery,
            cpu_us: cpu.as_secs_f64() * 1e6 / count as f64,
            resident_mib: resident as f64 / processes.len() as f64 / f64::from(1 << 20),
            disk_bytes: disk().saturating_sub(disk_before) as f64 / count as f64,
            more: Value::Null,
            load,
            run,
        };
        point.print();
        point
    }

    /// The same with what else there is to say.
    pub(crate) fn with(self, more: Value) -> Self {
        Self { more, ..self }
    }

    /// Median commit latency, microseconds.
    pub(crate) fn p50_us(&self) -> f64 {
        self.run.latency.value_at_quantile(0.5) as f64 / 1e3
    }

    /// 99th percentile of the commit latency, microseconds.
    pub(crate) fn p99_us(&self) -> f64 {
        self.run.latency.value_at_quantile(0.99) as f64 / 1e3
    }

    pub(crate) fn print_head() {
        println!(
            "       number  load                    Hz  achieved | commit p50     p99 | event p50     p99 ms | CPU µs/tx | MiB/node | disk bytes/tx"
        );
    }

    fn print(&self) {
        let [p50, p99, event_p50, event_p99] =
            [(&self.run.latency, 0.5), (&self.run.latency, 0.99), (&self.delivery, 0.5), (&self.delivery, 0.99)]
                .map(|(times, quantile)| times.value_at_quantile(quantile) as f64 / 1e6);
        println!(
            "{:13}  {:18} {:7.0} {:9.1} | {p50:10.3} {p99:7.3} | {event_p50:9.3} {event_p99:7.3}    | {:9.1} | {:8.1} | {:7.0}",
            self.x, self.load.name, self.load.hz, self.run.achieved_hz, self.cpu_us, self.resident_mib, self.disk_bytes
        );
    }

    /// For programs.
    pub(crate) fn json(&self) -> Value {
        json!({
            "number": self.x, "load": self.load.name, "hz": self.load.hz, "messages": self.load.messages,
            "achieved_hz": self.run.achieved_hz, "transactions": self.run.latency.len(),
            "latency_ms": percentiles(&self.run.latency), "delivery_ms": percentiles(&self.delivery),
            "cpu_us": self.cpu_us, "resident_mib": self.resident_mib, "disk_bytes": self.disk_bytes, "more": self.more,
        })
    }
}
