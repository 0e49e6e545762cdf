//! The length of the chain.

use crate::Bench;
use crate::chain::Chain;
use crate::drivers::salma;
use crate::founding::{Founding, ONE_VOTER};
use crate::network::Network;
use crate::point::{Load, Point};
use crate::usage;
use serde_json::json;
use std::time::{Duration, Instant};

/// How long commands may be executed, microseconds: as short as that of a bridge's commands.
const TTL: u64 = 2_000_000;
/// The longest chain unless the environment says otherwise.
const BLOCKS_DEFAULT: usize = 1_000_000;
/// The blocks of a test.
const BLOCKS_SMOKE: usize = 50;

/// Blocks of one command each. The node executes them at its first start; measured is what comes after its second.
pub(crate) fn chain(bench: &Bench) -> Vec<Point> {
    let longest = std::env::var("LEDGERD_BENCH_BLOCKS").map_or(BLOCKS_DEFAULT, |text| text.parse().expect("blocks"));
    let counts = [10_000, 100_000, 1_000_000, 10_000_000].into_iter().filter(|blocks| *blocks <= longest);
    let counts = if bench.smoke { vec![BLOCKS_SMOKE] } else { counts.collect() };
    counts.into_iter().flat_map(|blocks| of_length(bench, blocks)).collect()
}

fn of_length(bench: &Bench, blocks: usize) -> Vec<Point> {
    let founding = Founding::new(ONE_VOTER);
    let height = Chain { blocks: blocks as u64, transactions: 1, ttl: TTL, executed: false }.write(&founding);
    let mut network = Network::of(founding);
    let executed = start(bench, &mut network, height);
    network.stop_last();
    let started = start(bench, &mut network, height);
    let disk = network.directories().map(usage::filled).sum::<u64>();
    println!(
        "{blocks} blocks: executed in {executed:.1} s, started in {started:.3} s, {:.1} MiB on disk, {:.0} bytes a block",
        disk as f64 / f64::from(1 << 20),
        disk as f64 / blocks as f64
    );
    let drivers = bench.runtime.block_on(salma(&network));
    let arrivals = bench.runtime.block_on(network.listen("Turtlebot4"));
    let more = json!({ "start_s": started, "execute_s": executed, "disk_bytes": disk });
    let measure = |hz| Point::measure(bench, &network, &drivers, &arrivals, blocks, Load::hz(hz)).with(more.clone());
    bench.rates().into_iter().map(measure).collect()
}

/// Starts the node; answers with the seconds until it has answered that it is there.
fn start(bench: &Bench, network: &mut Network, height: u64) -> f64 {
    let begin = Instant::now();
    network.start_node(0, "");
    while bench.runtime.block_on(network.height(0)) < height {
        std::thread::sleep(Duration::from_millis(5));
    }
    begin.elapsed().as_secs_f64()
}
