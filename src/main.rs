//! `ledgerd`: a node of a permissioned ledger for ROS 2 fleets.

use std::process::ExitCode;

fn main() -> ExitCode {
    ledgerd::run(ledgerd::Node::builder())
}
