//! `ledgerctl` as a program, without a node.

mod doctor;
mod machine;
mod transcripts;
