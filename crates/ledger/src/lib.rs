//! The domain of the ledger: transactions, blocks, the chain, chaincode and identities.
//!
//! Nothing here knows a network, an async runtime or a clock: time and randomness are arguments, and the disk is
//! a trait. So the whole of it runs in a simulator as it runs in a node.

pub mod block;
pub mod certificate;
mod chaincode;
mod code;
mod hash;
pub mod identity;
pub mod key;
pub mod msp;
mod rejection;
pub mod state;

pub use bytes::Bytes;
pub use chaincode::{Chaincode, Context, Environment, Event, Overlay, Registry, Revocation, StateRead, WriteSet};
pub use code::{Class, Code};
pub use hash::Hash;
pub use rejection::Rejection;
