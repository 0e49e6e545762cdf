//! A node: one ledger on a host, started and stopped in order.
//!
//! | module | content |
//! |---|---|
//! | `host` | the listener of the process, and TLS connections for one ledger or several |
//! | `instance` | one ledger, from its stores to its services |
//! | `outlet`, `revocations` | from ordering to the later subsystems; closing connections of revoked certificates |
//! | `bridge` | the bridge inside a node |
//! | `running`, `supervise` | `Node` and its builder; running it until it is stopped or ends |

mod bridge;
mod host;
mod instance;
mod outlet;
mod revocations;
mod running;
pub(crate) mod supervise;

pub use host::Host;
pub use running::{Node, NodeBuilder};
