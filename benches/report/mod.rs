//! What a bench leaves: a table on standard output for people, `target/bench/NAME.json` for programs.

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
    /// What a write with `fdatasync` of the same size took right after, in nanoseconds.
    pub(crate) disk: Histogram<u64>,
}

/// Prints the runs on one network, a line each.
pub(crate) fn print_table(title: &str, lines: &[Line]) {
    println!("\n{title}: from the time a command was due to its verdict, ms; the disk alone, ms");
    println!("      Hz  achieved  commands     p50     p95     p99   p99.9     max  growth | disk p50     p99");
    for Line { run, disk } in lines {
        let [p50, p95, p99, p99_9] = QUANTILES.map(|(_, quantile)| ms(run.latency.value_at_quantile(quantile)));
        println!(
            "{:8} {:9.1} {:9} {p50:7.3} {p95:7.3} {p99:7.3} {p99_9:7.3} {:7.3} {:7.2} | {:8.3} {:7.3}",
            run.hz,
            run.achieved_hz,
            run.latency.len(),
            ms(run.latency.max()),
            run.growth,
            ms(disk.value_at_quantile(0.5)),
            ms(disk.value_at_quantile(0.99)),
        );
    }
}

/// The runs on one network for [`write`].
pub(crate) fn lines(lines: &[Line]) -> Value {
    let line = |Line { run, disk }: &Line| {
        json!({
            "hz": run.hz,
            "achieved_hz": run.achieved_hz,
            "commands": run.latency.len(),
            "latency_ms": percentiles(&run.latency),
            "sending_ms": percentiles(&run.sending),
            "disk_ms": percentiles(disk),
            "growth": run.growth,
        })
    };
    lines.iter().map(line).collect()
}

/// Writes `target/bench/NAME.json`.
pub(crate) fn write(name: &str, results: &Value) {
    let path = bench_directory().join(format!("{name}.json"));
    let document = json!({ "bench": name, "commit": commit(), "machine": machine(), "results": results });
    std::fs::write(&path, serde_json::to_string_pretty(&document).unwrap()).unwrap();
    println!("\nwritten to {}", path.display());
}

fn percentiles(histogram: &Histogram<u64>) -> Value {
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
