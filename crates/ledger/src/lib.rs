//! ledger.

pub mod block_store;
pub mod disk;
pub mod entry;
pub mod segment;
