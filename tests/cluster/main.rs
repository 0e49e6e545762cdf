//! Networks of three voters and a learner in two organisations, as real processes on real disks. They suffer as such
//! machines do: they are killed, cut off, stopped, filled up and damaged. After each fault nothing that was
//! acknowledged is lost or executed twice, and all nodes agree.
//!
//! | module | what happens |
//! |---|---|
//! | `kills` | `kill -9` under load, one node at a time and two at a time |
//! | `partitions` | a leader cut off, one-way loss, a minority with the client's gateway, flapping links |
//! | `pauses` | a leader that was stopped and wakes up, believing that it still leads |
//! | `full_disks` | a voter without space, and a leader |
//! | `examples` | the example network on three machines, as it stands |
//! | `damage` | cut and flipped bytes in segments and in the state store |
//! | `upgrade` | an older program in every place, one after the other upgraded |
//! | `cluster`, `load`, `audit`, `site` | the nodes; users who publish; what must be true at the end; the network |
//!
//! `LEDGERD_TEST_ROUNDS` multiplies the faults (default 1), `LEDGERD_TEST_SEED` repeats them.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    unreachable_pub,
    reason = "tests"
)]

mod audit;
mod cluster;
mod damage;
mod examples;
mod full_disks;
mod kills;
mod load;
mod partitions;
mod pauses;
mod site;
mod upgrade;

use ledgerd_support as support;
use testkit::own_network;

/// Times the usual number of faults in `./test --long`.
const ROUNDS_LONG: u64 = 4;

/// How many times the usual number of faults: `LEDGERD_TEST_ROUNDS`, else more in `./test --long` than in `./test`.
fn rounds() -> u64 {
    let usual = if std::env::var_os("LEDGERD_TEST_LONG").is_some() { ROUNDS_LONG } else { 1 };
    std::env::var("LEDGERD_TEST_ROUNDS").map_or(usual, |rounds| rounds.parse().expect("a number of rounds"))
}
