//! The report of a bench: a table on standard output for people, `target/bench/NAME.json` for programs.
#![allow(dead_code, clippy::allow_attributes, reason = "each bench uses its own part")]

use crate::founding::bench_directory;
use crate::load::Run;
use hdrhistogram::Histogram;
use serde_json::{Value, json};
use std::process::Command;

/// Percentiles as they are called in results.
const QUANTILES: [(&str, f64); 4] = [("p50", 0.5), ("p95", 0.95), ("p99", 0.99), ("p99_9", 0.999)];

/// One rate.
pub(crate) struct Line {
    /// Commands at that rate.
    pub(crate) run: Run,
    /// Commands of these that were refused, because more came than could be ordered in time.
    pub(crate) refused: usize,
    /// From when a command was due to its event at the last node's subscriber, in nanoseconds.
    pub(crate) delivery: Histogram<u64>,
    /// The time of a write with `fdatasync` of the same size right after, in nanoseconds.
    pub(crate) disk: Histogram<u64>,
}

/// Prints the runs on one network, a line each.
pub(crate) fn print_table(title: &str, lines: &[Line]) {
    println!("\n{title}: from the time a command was due to its verdict, to its event; the disk alone; ms");
    println!(
        "      Hz  achieved  commands  refused     p50     p95     p99   p99.9     max  growth | event p50     p99 | disk p50     p99"
    );
    for Line { run, refused, delivery, disk } in lines {
        let [p50, p95, p99, p99_9] = QUANTILES.map(|(_, quantile)| ms(run.latency.value_at_quantile(quantile)));
        println!(
            "{:8} {:9.1} {:9} {refused:8} {p50:7.3} {p95:7.3} {p99:7.3} {p99_9:7.3} {:7.3} {:7.2} | {:9.3} {:7.3} | {:8.3} {:7.3}",
            run.hz,
            run.achieved_hz,
            run.latency.len(),
            ms(run.latency.max()),
            run.growth,
            ms(delivery.value_at_quantile(0.5)),
            ms(delivery.value_at_quantile(0.99)),
            ms(disk.value_at_quantile(0.5)),
            ms(disk.value_at_quantile(0.99)),
        );
    }
}

/// The runs on one network for [`write`].
pub(crate) fn lines(lines: &[Line]) -> Value {
    let line = |Line { run, refused, delivery, disk }: &Line| {
        json!({
            "hz": run.hz,
            "achieved_hz": run.achieved_hz,
            "commands": run.latency.len(),
            "refused": refused,
            "latency_ms": percentiles(&run.latency),
            "sending_ms": percentiles(&run.sending),
            "delivery_ms": percentiles(delivery),
            "disk_ms": percentiles(disk),
            "growth": run.growth,
        })
    };
    lines.iter().map(line).collect()
}

/// One of several that do the same work in turns. Latencies are in nanoseconds.
pub(crate) struct Side {
    /// As it is called in results.
    pub(crate) name: String,
    /// Calls one after the other.
    pub(crate) one_in_flight: Histogram<u64>,
    /// At 50 Hz, from when a call was due.
    pub(crate) at_50_hz: Histogram<u64>,
    /// At 200 Hz, likewise.
    pub(crate) at_200_hz: Histogram<u64>,
}

impl Side {
    /// Adds another turn.
    pub(crate) fn add(&mut self, turn: &Self) {
        self.one_in_flight.add(&turn.one_in_flight).unwrap();
        self.at_50_hz.add(&turn.at_50_hz).unwrap();
        self.at_200_hz.add(&turn.at_200_hz).unwrap();
    }
}

/// Prints the sides, each also as a multiple of the first.
pub(crate) fn print_sides(variant: &str, sides: &[Side]) {
    let Some(first) = sides.first() else { return };
    println!("\nside by side, {variant}, ms (and as a multiple of: {})", first.name);
    let columns = ["one in flight p50", "50 Hz p50", "50 Hz p99", "200 Hz p50", "200 Hz p99"];
    println!("{:35} {}", "", columns.map(|column| format!("{column:>20}")).join(" "));
    for side in sides {
        let figure =
            |of: &dyn Fn(&Side) -> u64| format!("{:.3} ({:5.2} x)", ms(of(side)), of(side) as f64 / of(first) as f64);
        let figures = [
            figure(&|side| side.one_in_flight.value_at_quantile(0.5)),
            figure(&|side| side.at_50_hz.value_at_quantile(0.5)),
            figure(&|side| side.at_50_hz.value_at_quantile(0.99)),
            figure(&|side| side.at_200_hz.value_at_quantile(0.5)),
            figure(&|side| side.at_200_hz.value_at_quantile(0.99)),
        ];
        println!("{:35} {}", side.name, figures.map(|figure| format!("{figure:>20}")).join(" "));
    }
}

/// The sides for [`write`].
pub(crate) fn sides(sides: &[Side]) -> Value {
    let side = |side: &Side| {
        json!({
            "name": side.name,
            "one_in_flight_ms": percentiles(&side.one_in_flight),
            "at_50_hz_ms": percentiles(&side.at_50_hz),
            "at_200_hz_ms": percentiles(&side.at_200_hz),
        })
    };
    sides.iter().map(side).collect()
}

/// Writes `target/bench/NAME.json`.
pub(crate) fn write(name: &str, results: &Value) {
    let path = bench_directory().join(format!("{name}.json"));
    let document = json!({ "bench": name, "commit": commit(), "machine": machine(), "results": results });
    std::fs::write(&path, serde_json::to_string_pretty(&document).unwrap()).unwrap();
    println!("\nwritten to {}", path.display());
}

/// Percentiles and the maximum of nanoseconds, in milliseconds.
pub(crate) fn percentiles(histogram: &Histogram<u64>) -> Value {
    let mut object: serde_json::Map<_, _> = QUANTILES
        .iter()
        .map(|(name, quantile)| ((*name).to_owned(), ms(histogram.value_at_quantile(*quantile)).into()))
        .collect();
    object.insert("max".into(), ms(histogram.max()).into());
    object.into()
}

fn ms(nanoseconds: u64) -> f64 {
    nanoseconds as f64 / 1e6
}

/// The commit that was measured, with a `+` if files were changed since; empty outside of a checkout.
fn commit() -> String {
    let git = |args: &[&str]| {
        let output = Command::new("git").args(args).current_dir(env!("CARGO_MANIFEST_DIR")).output();
        output.ok().and_then(|output| String::from_utf8(output.stdout).ok()).unwrap_or_default()
    };
    let changed = if git(&["status", "--porcelain", "--untracked-files=no"]).is_empty() { "" } else { "+" };
    format!("{}{changed}", git(&["rev-parse", "--short", "HEAD"]).trim())
}

fn machine() -> Value {
    let read = |path| std::fs::read_to_string(path).unwrap_or_default();
    let model = |line: &str| line.strip_prefix("model name")?.split_once(": ").map(|(_, model)| model.to_owned());
    json!({
        "processor": read("/proc/cpuinfo").lines().find_map(model),
        "cores": std::thread::available_parallelism().map_or(0, usize::from),
        "kernel": read("/proc/sys/kernel/osrelease").trim(),
        // Others on the machine show here: compare runs of about the same load only.
        "load_average": read("/proc/loadavg").trim(),
    })
}
