//! The other nodes: connections, synchronisation, and the checks that all have the same chain.
//!
//! | module | content |
//! |---|---|
//! | `connections`, `service` | one outgoing connection to each node; the service that other nodes call |
//! | `reachability` | whether this node reaches a leader |
//! | `question`, `receipt` | asking other nodes what they have; receipts between nodes |
//! | `sync` | block and snapshot sync: fetching, peer trust, serving |
//! | `conductor` | starts and ends the orderer, and synchronises when the node is too far behind |
//! | `chain_monitor` | compares the chain with the voters' and stops a node that differs |
//! | `attestation` | signs what this node computed into the ledger, and compares what others signed |
//! | `quorum_certificates` | signatures of voters over blocks, and proofs of lies |
//! | `early_stop` | emergency stops, broadcast ahead of ordering |

pub(crate) mod attestation;
pub(crate) mod chain_monitor;
pub(crate) mod conductor;
pub(crate) mod connections;
pub(crate) mod early_stop;
pub(crate) mod question;
pub(crate) mod quorum_certificates;
pub(crate) mod reachability;
mod receipt;
pub(crate) mod service;
pub(crate) mod sync;
