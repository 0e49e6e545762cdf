//! `ledgerctl` as a program, without a node.

#![expect(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, reason = "tests")]

mod doctor;
mod machine;
mod transcripts;
