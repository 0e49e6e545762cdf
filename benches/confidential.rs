//! The cost of a confidential service: the same command at 50 Hz, plain and encrypted, in turns. It begins when a command was due,
//! and ends with its verdict, and when a reader at the other organisation's node has opened it.
//!
//! `cargo bench --bench confidential`; `LEDGERD_BENCH_SECONDS` sets the length of each side.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod founding;
mod load;
mod network;

use founding::PAPER;
use hdrhistogram::Histogram;
use load::{histogram, open_loop};
use network::{Arrivals, Network, Operator};
use std::hint::black_box;
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};

/// The paper's frequency.
const HZ: f64 = 50.0;
/// Turns that each side takes.
const TURNS: u32 = 10;
/// Length of each side unless the environment says otherwise, in seconds.
const SECONDS_DEFAULT: f64 = 60.0;

/// One of the two services. Latencies are in nanoseconds.
struct Side {
    name: &'static str,
    operator: Operator,
    arrivals: Arrivals,
    commit: Histogram<u64>,
    delivery: Histogram<u64>,
}

fn main() {
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let seconds = std::env::var("LEDGERD_BENCH_SECONDS").map_or(SECONDS_DEFAULT, |text| text.parse().expect("seconds"));
    let turn = Duration::from_secs_f64(if smoke { 1.0 } else { seconds }) / TURNS;
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let network = runtime.block_on(Network::start(PAPER));
    let mut sides = runtime.block_on(async {
        let plain = (network.operator("Turtlebot4").await, network.listen("Turtlebot4").await);
        let arrivals = network.listen_confidential("Husky").await;
        let sealed = (network.operator("Husky").await.sealing(&network).await, arrivals);
        [("plain", plain), ("confidential", sealed)].map(|(name, (operator, arrivals))| {
            let empty = || histogram(std::iter::empty());
            Side { name, operator, arrivals, commit: empty(), delivery: empty() }
        })
    });
    for side in &mut sides {
        // The first commands bring the certificate and warm caches.
        side.take(&runtime, Duration::from_millis(500));
        (side.commit, side.delivery) = (histogram(std::iter::empty()), histogram(std::iter::empty()));
    }
    for number in 0..TURNS {
        let first = usize::from(number % 2 == 1);
        sides[first].take(&runtime, turn);
        sides[1 - first].take(&runtime, turn);
    }
    println!("{:14} {:>10} {:>10} {:>10} {:>10}  (ms at {HZ} Hz)", "", "commit p50", "p99", "opened p50", "p99");
    for side in &sides {
        let ms = |histogram: &Histogram<u64>, quantile| histogram.value_at_quantile(quantile) as f64 / 1e6;
        let (commit, delivery) = (&side.commit, &side.delivery);
        println!(
            "{:14} {:10.3} {:10.3} {:10.3} {:10.3}",
            side.name,
            ms(commit, 0.5),
            ms(commit, 0.99),
            ms(delivery, 0.5),
            ms(delivery, 0.99)
        );
    }
    let p50 = |side: &Side| side.delivery.value_at_quantile(0.5) as f64 / 1e6;
    println!("added at p50: {:+.3} ms, ratio {:.3}", p50(&sides[1]) - p50(&sides[0]), p50(&sides[1]) / p50(&sides[0]));
    println!("of which one message is sealed and opened in {:.2} µs", alone(if smoke { 1000 } else { 200_000 }));
}

impl Side {
    fn take(&mut self, runtime: &Runtime, duration: Duration) {
        let first = self.operator.next_seq();
        let run = open_loop(runtime, HZ, duration, || {
            let verdict = self.operator.command();
            async move { drop(verdict.await.expect("a verdict")) }
        });
        let due = |number: u32| run.start + Duration::from_secs_f64(f64::from(number) / HZ);
        let arrived = (0..).zip(first..self.operator.next_seq());
        let delivery = histogram(arrived.map(|(number, seq)| self.arrivals.of(seq) - due(number)));
        self.commit.add(&run.latency).unwrap();
        self.delivery.add(&delivery).unwrap();
    }
}

/// Microseconds to seal and open one Twist, without a ledger.
fn alone(times: u32) -> f64 {
    use ledger_base::hash::Hash;
    use ledger_confidential::{Keyring, ReadingKey, Sealer};
    use ledger_contract::{Reader, Readers};
    let (service, publisher) = ("Husky/cmd_vel", "Org1/Salma");
    let mut keyring = Keyring::new(Hash::ZERO, "Org2/Husky".into(), ReadingKey::generate());
    let reader =
        Reader { reader: "Org2/Husky".into(), key: keyring.public_hex(), serial: String::new(), may_read: true };
    let readers = Readers { service: service.into(), readers: vec![reader], keys: vec![] };
    let (share, fresh) = Sealer::share(&Hash::ZERO, publisher, &readers).unwrap();
    keyring.learn(service, publisher, 1, &share);
    let (sealer, message) = (fresh.shared_at(1), founding::twist());
    let begun = Instant::now();
    for seq in 0..u64::from(times) {
        let sealed = sealer.seal(1, seq, &message).unwrap();
        black_box(keyring.open(service, publisher, 1, seq, &sealed).unwrap());
    }
    begun.elapsed().as_secs_f64() * 1e6 / f64::from(times)
}
