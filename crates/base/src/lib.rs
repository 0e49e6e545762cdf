//! The foundation of every other crate: no network, no chaincode, no cryptography beyond a hash.
//!
//! | module | content |
//! |---|---|
//! | [`hash`] | SHA-256 values |
//! | [`rejection`] | rejections and their stable codes |
//! | [`invariant`] | invariants, and the end of a process that breaks one |
//! | [`moment`] | moments in time as text |
//! | [`mutation`] | deliberate bugs that the simulation must notice |
//! | [`durable`] | files that survive a crash whole |
//! | [`settings`] | TOML files, read setting by setting |
//! | [`nearest`] | "did you mean" |
//! | [`progress`] | progress of long commands on a terminal |
//! | [`shell`] | words of a shell, for commands that are printed |
//! | [`shared_results`] | results of pure functions that simulated nodes share |
//! | [`text`] | text files as editors write them |
//! | [`units`] | spans of time and sizes as text |

#![forbid(unsafe_code)]

pub mod durable;
pub mod hash;
pub mod invariant;
pub mod moment;
pub mod mutation;
pub mod nearest;
pub mod progress;
pub mod rejection;
pub mod settings;
pub mod shared_results;
pub mod shell;
pub mod text;
pub mod units;
