//! The paper's experiment with a robot that moves: `cargo run --release -p arena`. docs/arena.md describes it.
//!
//! | module | content |
//! |---|---|
//! | `model` | robot, controllers, link, figures, claims: pure |
//! | `picture` | pictures of the runs, and the page |
//! | `play` | the runs, over real nodes, bridges and DDS |

#![cfg_attr(test, expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests"))]

mod model;
mod picture;
mod play;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    // The nodes and bridges of the experiment are processes of this program, too.
    match std::env::args().nth(1).as_deref() {
        Some("run" | "bridge") => ledgerd::run(ledgerd::Node::builder()),
        _ => ledgerd::run_program(play::run(play::Options::parse())),
    }
}
