//! A learner that was never there catches up with a long chain: how long does it take, and how fast is execution alone?
//!
//! The chain is made without nodes and put into the first node's directory, which executes it when it starts; then the
//! learner of the other organisation starts with nothing.
//!
//! `cargo bench --bench catch_up`; `LEDGERD_BENCH_TRANSACTIONS` sets the length.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a bench prints its results and ends at the first fault"
)]

mod chain;
mod founding;
mod network;

use chain::Chain;
use founding::{Founding, PAPER};
use network::Network;
use std::time::{Duration, Instant};
use tokio::runtime::Builder;

/// Commands of a block: what gathers under load.
const BLOCK_TRANSACTIONS: u64 = 500;
/// How long commands may be executed, microseconds.
const TTL: u64 = 60_000_000;

fn main() {
    let smoke = !std::env::args().any(|argument| argument == "--bench");
    let wanted = std::env::var("LEDGERD_BENCH_TRANSACTIONS").map_or(1_000_000, |text| text.parse().expect("a number"));
    let wanted: u64 = if smoke { 1000 } else { wanted };
    let founding = Founding::new(PAPER);
    let begin = Instant::now();
    let chain = Chain {
        blocks: wanted.div_ceil(BLOCK_TRANSACTIONS),
        transactions: BLOCK_TRANSACTIONS,
        ttl: TTL,
        executed: false,
    };
    let height = chain.write(&founding);
    println!("{wanted} transactions in {height} blocks, signed and written in {:.1} s", begin.elapsed().as_secs_f64());
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    runtime.block_on(async {
        let mut network = Network::of(founding);
        for (node, what) in
            ["the voter starts and executes its blocks", "the learner starts and catches up"].iter().enumerate()
        {
            let begin = Instant::now();
            network.start_node(node, "");
            while network.height(node).await < height {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            let seconds = begin.elapsed().as_secs_f64();
            println!("{what}: {seconds:.1} s, {:.0} transactions a second", wanted as f64 / seconds);
        }
    });
}
