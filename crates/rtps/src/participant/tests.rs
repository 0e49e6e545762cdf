//! Participants in virtual time over a simulated network.

#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]

mod by_hand;
mod counters;
mod endpoints;
mod field;
mod liar;
mod liveliness;
mod memory;
mod network;
mod node;
mod packing;
mod participants;
mod random;
mod readers;
mod simulation;
