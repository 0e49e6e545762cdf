//! Images through the DDS of a bridge, from and to software that we did not write: from publishing to receiving, on one
//! machine. The passage of a bridge is one way in and one way out of it; beside it, the others among themselves.
//!
//! All links take turns, so that they meet the same mood of the machine. Every stream is reliable; the others keep the last 10
//! samples, as ROS 2 does. `cargo bench -p ros-bridge --bench passage [-- fast]`, with `LEDGERD_TEST_PYTHON` naming a Python
//! that has `cyclonedds`, as `./test` installs it. `fast` adds Fast DDS, and needs g++ and libfastrtps-dev.
//! `LEDGERD_BENCH_SECONDS` sets the length of each turn. Runs in a network of its own.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::unreachable,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod own_network;
#[path = "passage/stream.rs"]
mod stream;

use hdrhistogram::Histogram;
use std::time::Duration;
use stream::{Party, run};
use tokio::runtime::Builder;

/// Bytes of an image, and images a second; last, messages as small as commands, as often as a fast controller sends them.
const STREAMS: [(usize, f64); 4] = [(300_000, 30.0), (1_000_000, 30.0), (4_000_000, 10.0), (48, 1_000.0)];
/// Turns that each link takes at each size.
const TURNS: u32 = 3;
/// From whom, to whom.
const LINKS: [[Party; 2]; 3] =
    [[Party::Cyclone, Party::Cyclone], [Party::Cyclone, Party::Bridge], [Party::Bridge, Party::Cyclone]];
const FAST_LINKS: [[Party; 2]; 3] =
    [[Party::Fast, Party::Fast], [Party::Fast, Party::Bridge], [Party::Bridge, Party::Fast]];

/// The outcome of one link at one size. Latencies are in microseconds.
struct Line {
    link: [Party; 2],
    sent: u32,
    latency: Histogram<u64>,
}

fn main() {
    assert!(own_network::enter(), "needs a network of its own: `unshare`, `ip`, and the right to use them");
    let has = |word: &str| std::env::args().any(|argument| argument == word);
    let smoke = !has("--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(4.0, |text| text.parse().expect("seconds"));
    let duration = Duration::from_secs_f64(if smoke { 0.5 } else { seconds });
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    println!("    bytes   Hz  link                received    p50    p99    max  ms");
    for (size, hz) in if smoke { &STREAMS[..1] } else { &STREAMS[..] } {
        let more = if has("fast") { &FAST_LINKS[..] } else { &[] };
        let links = LINKS.iter().chain(more);
        let mut lines: Vec<Line> = links.map(|link| Line::new(*link)).collect();
        for _ in 0..if smoke { 1 } else { TURNS } {
            for line in &mut lines {
                let count = (hz * duration.as_secs_f64()).ceil() as u32;
                let [from, to] = line.link;
                line.latency.add(run(&runtime, from, to, (*size, *hz, count))).unwrap();
                line.sent += count;
            }
        }
        for line in lines {
            line.print(*size, *hz);
        }
    }
}

impl Line {
    fn new(link: [Party; 2]) -> Self {
        Self { link, sent: 0, latency: stream::latencies([]) }
    }

    fn print(&self, size: usize, hz: f64) {
        let [p50, p99, max] = [0.5, 0.99, 1.0].map(|quantile| self.latency.value_at_quantile(quantile) as f64 / 1e3);
        let [from, to] = self.link.map(Party::name);
        let (received, sent) = (self.latency.len(), self.sent);
        println!(
            "{size:9} {hz:4}  {:18} {received:4} of {sent:4} {p50:6.1} {p99:6.1} {max:6.1}",
            format!("{from} > {to}")
        );
    }
}
