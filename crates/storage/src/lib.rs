//! The files of a node, and what they mean: the log of blocks, their results, the world state, snapshots, archives.
//!
//! It verifies no signature and runs no chaincode. A [disk](disk::Disk) is an argument, so a simulator can tear, lose
//! and fill it. The remains of a failed or short write are repaired, refused with file and byte, or made again; no
//! answer comes from them.
//!
//! | module | what is there |
//! |---|---|
//! | [`disk`] | one directory of files: a real one, or a simulated one (feature `sim`) |
//! | [`segment`], [`entry`] | the bytes of the log |
//! | [`block_store`] | the log: append, flush, read, recover, drop |
//! | [`result`](mod@result), [`results`] | what executing a block gave, and the files that keep it |
//! | [`state`] | the world state over a store: in memory, or in sled (feature `sled`); layers of writes |
//! | [`audit`] | an index of decisions about control, in a store of its own |
//! | [`snapshot`] | the world state at a height, the same bytes on every node |
//! | [`retention`], [`archive`] | which blocks are dropped, and writing them out before |
//! | [`layout`] | what a data directory is made of |
//!
//! ```
//! use ledger_storage::block_store::{BlockStore, Options};
//! use ledger_storage::disk::RealDisk;
//! use ledger_storage::entry::{Entry, EntryKind};
//! use std::sync::Arc;
//!
//! # let directory = tempfile::tempdir()?;
//! # let path = directory.path().join("blocks");
//! {
//!     let (store, _) = BlockStore::open(Arc::new(RealDisk::open(&path)?), Options::new([7; 32], || 42))?;
//!     store.append(&[Entry { index: 1, term: 1, kind: EntryKind::Normal, data: "a block".into() }], None)?;
//!     assert_eq!(store.flush()?, 1, "the first entry is durable");
//! }
//! let (store, _) = BlockStore::open(Arc::new(RealDisk::open(&path)?), Options::new([7; 32], || 43))?;
//! assert_eq!(store.entry(1)?.map(|entry| entry.data), Some("a block".into()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod archive;
pub mod audit;
pub mod block_store;
pub mod disk;
pub mod entry;
pub mod layout;
pub mod result;
pub mod results;
pub mod retention;
pub mod segment;
pub mod snapshot;
pub mod state;
