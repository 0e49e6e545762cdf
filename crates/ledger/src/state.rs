//! The world state: the keys and values that executing all blocks leaves.

mod memory;

pub use memory::MemoryState;
