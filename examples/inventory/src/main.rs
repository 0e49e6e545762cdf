//! A node with a chaincode of its own: an inventory of what robots found. The tutorial is in README.md.

mod inventory;

use inventory::Inventory;
use std::process::ExitCode;

fn main() -> ExitCode {
    ledgerd::run(ledgerd::Node::builder().chaincode(Inventory))
}
