//! `ledgerd-bridge-zenoh`: `ledgerd` with `transport = "zenoh"` for its bridge.
//!
//! It has all commands of `ledgerd`. Only the feature `zenoh` of `ros-bridge` is added.

use std::process::ExitCode;

fn main() -> ExitCode {
    ledgerd::run(ledgerd::Node::builder())
}
