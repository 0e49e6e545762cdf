//! A node with a rule of its own: see README.md.

mod fair_share;

use fair_share::FairShare;
use std::process::ExitCode;

fn main() -> ExitCode {
    ledgerd::run(ledgerd::Node::builder().rule(FairShare))
}
