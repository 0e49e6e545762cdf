//! The process and the machine: configuration, logs, clock, memory, processors, and limits of connections. Nothing here
//! knows a ledger.
//!
//! | module | content |
//! |---|---|
//! | `config` | the configuration file, with every fault at once |
//! | `telemetry`, `meters`, `terminal` | logs; histograms of the steps of a command; lines on the terminal, and signals |
//! | `failure` | how a part of the node ends the node |
//! | `clock`, `random` | time that never goes back; random numbers of the operating system |
//! | `idle_control`, `scheduler_slices`, `memory` | processors that may not sleep yet; scheduler slices; returning memory to the OS |
//! | `caller`, `connection_limiter` | who calls; connections per peer |
//! | `page_connections`, `tls_files` | connections of pages over HTTP; TLS from files of an operator |

pub(crate) mod caller;
pub(crate) mod clock;
pub mod config;
pub(crate) mod connection_limiter;
pub(crate) mod failure;
pub(crate) mod idle_control;
pub(crate) mod memory;
pub(crate) mod meters;
pub(crate) mod page_connections;
pub(crate) mod random;
pub(crate) mod scheduler_slices;
pub(crate) mod telemetry;
pub(crate) mod terminal;
pub(crate) mod tls_files;
