//! The parts of a data directory and of an archive.
//!
//! | name | content |
//! |---|---|
//! | `genesis.json` | the genesis of the network |
//! | `blocks/` | the [block store](crate::block_store) |
//! | `results/` | [results](crate::results) of executed blocks; made again from the blocks |
//! | `state/` | the [world state](crate::state); made again from the blocks |
//! | `audit/` | the [index of the audit](crate::audit); made again from the blocks |
//! | `snapshots/` | [snapshots](crate::snapshot), `<height, 20 digits>.snap` |

/// The genesis document.
pub const GENESIS_FILE: &str = "genesis.json";
/// The block store.
pub const BLOCKS_DIRECTORY: &str = "blocks";
/// The results of executed blocks.
pub const RESULTS_DIRECTORY: &str = "results";
/// The world state.
pub const STATE_DIRECTORY: &str = "state";
/// The index of the audit.
pub const AUDIT_DIRECTORY: &str = "audit";
/// The snapshots.
pub const SNAPSHOTS_DIRECTORY: &str = "snapshots";
