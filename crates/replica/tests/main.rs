//! Replicas on simulated disks and networks.

#![expect(clippy::unwrap_used, clippy::indexing_slicing, clippy::panic, clippy::print_stderr, reason = "tests")]

mod barrier;
mod budgets;
mod catch_up;
mod chaos;
mod clocks;
mod cluster;
mod driver;
mod members;
mod opening;
mod ordering;
mod reads;
mod trust;
mod voting;
mod withholding;
