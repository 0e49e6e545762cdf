//! What a node keeps in its data directory, and the work that its disk needs.
//!
//! | module | content |
//! |---|---|
//! | `files` | names of files in the data directory, and marks that keep a node from starting |
//! | `stores` | opening blocks, results and world state; rebuilding the latter |
//! | `log` | durable writes of blocks, on a disk that may be full |
//! | `blocks` | executed blocks for readers |
//! | `space` | how full the disk is, what is still accepted, and the reserve |
//! | `housekeeping`, `retention`, `scrub` | threads for work on the disk; dropping old blocks; reading old blocks to find damage |

pub(crate) mod blocks;
pub(crate) mod files;
pub(crate) mod housekeeping;
pub(crate) mod log;
pub(crate) mod retention;
pub(crate) mod scrub;
pub(crate) mod space;
pub(crate) mod stores;
