//! `ledgerd`, the node: orderer, peer, chaincode runtime, enrolment CA and gateway in one process.
//!
//! This crate puts together what the others do: it owns the threads, sockets and files. A node with a chaincode of your
//! own is a program of three lines:
//!
//! ```no_run
//! # struct Inventory;
//! # impl ledger::Chaincode for Inventory {
//! #     fn name(&self) -> &'static str { "inventory" }
//! #     fn invoke(&self, _: &mut ledger::Context<'_>, _: &str, _: &[bytes::Bytes]) -> Result<bytes::Bytes, ledger_base::rejection::Rejection> {
//! #         Ok(bytes::Bytes::new())
//! #     }
//! # }
//! fn main() -> std::process::ExitCode {
//!     ledgerd::run(ledgerd::Node::builder().chaincode(Inventory))
//! }
//! ```
//!
//! | module | what is there |
//! |---|---|
//! | `command` | the command line: `run`, `check`, `init`, `join`, `dev`, `demo`, `bridge`, `verify` |
//! | `process` | configuration, logs, clock, memory, processors, limits of connections |
//! | `storage` | what the node keeps, and the work that its disk needs |
//! | `ordering` | from a transaction to its verdict |
//! | `trust` | certificates of organisations and nodes, the CA, enrolment |
//! | `peers` | the other nodes: connections, synchronisation, comparing chains |
//! | `clients` | the gateway, the console, the pages for monitoring |
//! | `node` | a node of these parts, on a host |
//! | `tools` | the commands besides `run` |
//!
//! Each knows only those above it in this table, `command` knows all.

mod clients;
mod command;
mod node;
mod ordering;
mod peers;
mod process;
mod storage;
mod tools;
mod trust;

pub use command::{run, run_program, run_with};
pub use node::{Host, Node, NodeBuilder};
pub use process::config;
pub use process::failure::Ended;
pub use tools::{demo, setup};
pub use trust::ca;
