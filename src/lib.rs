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
//! | `config` | the configuration file, every fault at once |
//! | `host` | what the process gives: the listener, and TLS connections for one ledger or several; `Node` is a ledger on it |
//! | `instance` | one ledger, from its stores to its services, and back down in order |
//! | `clock` | time that never goes back |
//! | `stores` | opening blocks and world state; rebuilding the latter |
//! | `orderer` | the two threads between a transaction and its verdict |
//! | `blocks`, `waiters`, `denials` | executed blocks for readers, clients that wait, what was refused |
//! | `audit`, `refusals` | an index of who did what; what was refused, put on the ledger |
//! | `early` | emergency stops, of which robots hear before they are ordered |
//! | `bridge` | the bridge inside a node |
//! | `peers` | TLS connections between nodes |
//! | `company` | what the other nodes say about the chain, and what this one stops for |
//! | `gateway` | the gRPC API |
//! | `http` | the HTTP API: the gateway's calls as JSON |
//! | `admin`, `console`, `doors` | pages over HTTP: readiness and figures; the console for browsers; their connections |
//! | `ca`, `enrolment` | the certificate authority of an organisation and its API |
//! | `identity` | which of the network's nodes this is |
//! | `renewal` | the node's certificate, renewed before it runs out |
//! | `setup`, `join` | founding a network; bringing a node into one |
//! | `backup`, `recover` | a copy of a node for the safe; going on with one node when most are lost |
//! | `verify` | checking a chain offline |
//! | `housekeeping`, `scrub` | what is done beside the work; reading old blocks to find damage |
//! | `space` | how full the disk is, and what is still accepted |
//! | `awake`, `slice`, `memory` | processors that may not sleep yet; short turns on them; memory that goes back |
//! | `dev`, `demo` | a network of one for playing; the paper's experiment |

mod admin;
mod audit;
mod awake;
mod backup;
mod blocks;
mod bridge;
pub mod ca;
mod catch_up;
mod certificates;
mod clock;
mod command;
mod company;
mod conductor;
pub mod config;
mod console;
mod demo;
mod denials;
mod dev;
mod doors;
mod early;
mod enrolment;
mod gateway;
mod health;
mod host;
mod housekeeping;
mod http;
mod identity;
mod instance;
mod join;
mod memory;
mod meters;
mod orderer;
mod peers;
mod random;
mod recover;
mod refusals;
mod renewal;
mod retention;
mod scrub;
pub mod setup;
mod signer;
mod slice;
mod space;
mod speaks;
mod stores;
mod telemetry;
mod tls_files;
mod verify;
mod waiters;
mod witness;

pub use command::{run, run_with};
pub use host::{Host, Node, NodeBuilder};
pub use instance::Ended;
