//! The parts of a bridge beside software that we did not write.

#![expect(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "tests")]

mod calls;
#[path = "support/commands.rs"]
mod commands;
mod cyclone;
mod dds;
mod forged;
mod large;
mod peers;
mod ros2;
mod shm;
