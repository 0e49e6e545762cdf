//! Real processes, real TLS, real disks: `ledgerd` and `ledgerctl` as users run them, and as disks and enemies treat
//! them.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    clippy::print_stderr,
    unreachable_pub,
    missing_docs,
    reason = "tests"
)]

#[path = "../support/mod.rs"]
mod support;

mod story;
mod crash;
mod rebuild;
mod verify;
mod hostile;
mod config;
mod disk_full;
mod two_nodes;
