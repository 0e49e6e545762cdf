//! The domain of the ledger: transactions, blocks, the chain, chaincode and identities.
//!
//! Nothing here knows a network, an async runtime or a clock: time and randomness are arguments, and the disk is
//! a trait. So the whole of it runs in a simulator as it runs in a node.

pub mod archive;
pub mod block;
pub mod block_store;
pub mod certificate;
mod chain;
mod chaincode;
mod code;
pub mod disk;
pub mod entry;
mod execution;
pub mod governance;
mod hash;
mod identities;
pub mod identity;
pub mod key;
pub mod members;
pub mod msp;
#[doc(hidden)]
pub mod mutation;
pub mod network;
mod rejection;
pub mod result;
pub mod results;
pub mod retention;
pub mod segment;
pub mod snapshot;
pub mod state;
pub mod transaction;
mod verified;
#[cfg(feature = "sled")]
pub mod verify;
pub mod writes;

pub use bytes::Bytes;
pub use chain::{Admission, Ground, Ledger, Outcome, Refusal, Seal, Step, TransactionRecord};
pub use chaincode::{
    Chaincode, Context, Environment, Event, Foretold, Overlay, Registry, Revocation, StateRead, WriteSet,
};
pub use code::{Class, Code};
pub use hash::Hash;
pub use rejection::Rejection;
