//! The shared parts of tests with real nodes: processes that never stay behind, networks in temporary directories,
//! `ledgerctl`.
//!
//! | module | what is there |
//! |---|---|
//! | `process` | a child process, killed by its id when the test ends |
//! | `programs` | where the built programs are |
//! | `network` | a network on disk, its nodes and identities |
//! | `readme` | blocks of commands in documents, typed as they stand |
//! | `directory` | a copy of a stopped node's directory |
//! | `small_disk` | a disk that can be full |
//! | `dev` | `ledgerd dev` with its users |
//! | `page` | the page for whoever watches a node or a bridge |
//! | `two_networks` | two networks behind one listener |
//! | `ctl` | one run of `ledgerctl`, or of `ledgerd verify` |
//! | `wire` | connections below the Rust client |
//! | `wait` | conditions with a deadline, and a small source of random numbers |
//!
//! A network namespace for a test is `testkit::own_network`.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "for tests"
)]

pub mod ctl;
pub mod dev;
pub mod directory;
pub mod network;
pub mod page;
pub mod process;
pub mod programs;
pub mod readme;
pub mod small_disk;
pub mod two_networks;
pub mod wait;
pub mod wire;

pub use ctl::Ctl;
pub use dev::Dev;
pub use network::{Fleet, connect};
pub use process::Process;
pub use wait::{Dice, eventually, until};
