//! Snapshots: the world state at a height, and what else a ledger needs to go on from there, as bytes that every node
//! makes alike.
//!
//! A node makes one at heights that the genesis names, keeps the newest two, and signs their
//! [content](Manifest::content). A node that is far behind fetches the manifest and the chunks, checks the signers of
//! the content, and installs it. The ledger opened on it stands where the others stood, and refuses the same
//! duplicates.
//!
//! | bytes of the file | content |
//! |---|---|
//! | 16 | `LEDGRSNP`, format version `u32` BE, zero `u32` |
//! | as the manifest says | the chunks, one after the other |
//! | | the [manifest](Manifest) |
//! | 16 | bytes of the manifest `u32` BE, CRC-32C of the manifest `u32` BE, `LEDGREND` |
//!
//! The chunks are one stream of items cut every MiB. First are the pairs of the world state in order of keys: `1`,
//! length of the key `u32` BE, of the value `u32` BE, both. Then come the results of the blocks of the last 120 s of
//! block time: `2`, height `u64` BE, length `u32` BE, and the result. It is without events and without the words of
//! refusals, which may differ between versions of the program.

mod build;
mod content;
mod file;
mod install;
mod items;
mod manifest;

pub use file::Snapshot;
pub use install::Installer;
pub use items::Item;
pub use manifest::{CHUNK_BYTES_MAX, CHUNKS_MAX, Chunk, MANIFEST_BYTES_MAX, Manifest};

use crate::disk::Disk;
use crate::result::BlockResult;
use crate::results::{ResultStore, StoredResult};
use crate::state::{State, Tip};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::io::{self, ErrorKind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};

/// How many snapshots a node keeps.
pub const SNAPSHOTS_KEPT: usize = 2;

/// Makes the result of the block at a height whole; none if that block was dropped.
pub type Complete<'a> = dyn FnMut(u64, StoredResult) -> Result<Option<BlockResult>, Rejection> + 'a;

/// The snapshots of a node.
pub struct Snapshots {
    disk: Arc<dyn Disk>,
    network: Hash,
    /// Oldest first.
    kept: RwLock<Vec<Arc<Snapshot>>>,
    /// One is made at a time.
    making: Mutex<()>,
    /// And one fetched.
    fetching: Mutex<()>,
    /// The height of one that is kept although newer ones are there; 0 = none.
    pinned: AtomicU64,
}

impl Snapshots {
    /// Opens the snapshots in a directory. Damaged ones and those of other networks are left out.
    ///
    /// # Errors
    /// [`Code::DiskFailed`] if the directory cannot be read.
    pub fn open(disk: Arc<dyn Disk>, network: Hash) -> Result<Self, Rejection> {
        let mut kept = Vec::new();
        for name in disk.list().map_err(|error| failed("list", "", &error))? {
            let Some(height) = file::height(&name) else { continue };
            let file = disk.open(&name).map_err(|error| failed("open", &name, &error))?;
            match Snapshot::read(file, &name) {
                Ok(found) if found.manifest().network == network && found.manifest().height == height => {
                    kept.push(Arc::new(found));
                }
                Ok(_) => tracing::warn!(%name, "ignoring a snapshot of another kind or network"),
                Err(fault) if fault.code == Code::Corrupt => {
                    tracing::warn!(code = fault.code.name(), reason = %fault, "ignoring a damaged snapshot")
                }
                Err(fault) => return Err(fault),
            }
        }
        let (making, fetching, pinned) = Default::default();
        Ok(Self { disk, network, kept: RwLock::new(kept), making, fetching, pinned })
    }

    /// The newest.
    pub fn newest(&self) -> Option<Arc<Snapshot>> {
        self.kept().last().map(Arc::clone)
    }

    /// The oldest: blocks before it can be dropped.
    pub fn oldest(&self) -> Option<Arc<Snapshot>> {
        self.kept().first().map(Arc::clone)
    }

    /// Keeps the one of this height, beside the newest ones, until another one is pinned.
    pub fn pin(&self, height: u64) {
        self.pinned.store(height, Ordering::Relaxed);
    }

    /// The one of a height.
    pub fn get(&self, height: u64) -> Option<Arc<Snapshot>> {
        self.kept().iter().find(|snapshot| snapshot.manifest().height == height).map(Arc::clone)
    }

    /// Takes a snapshot from elsewhere, chunk by chunk. The remains of an interrupted one of the same manifest are
    /// used.
    ///
    /// # Errors
    /// [`Code::WrongNetwork`]; a fault of the disk.
    pub fn install(&self, manifest: Manifest) -> Result<Installer<'_>, Rejection> {
        if manifest.network != self.network {
            return Err(Rejection::new(Code::WrongNetwork, "the snapshot belongs to another network")
                .found(manifest.network.to_string())
                .wanted(self.network.to_string()));
        }
        Installer::begin(self, manifest)
    }

    /// Makes the snapshot of what a state has stored, with the results of the blocks whose time is `since` or later;
    /// `complete` makes them whole. Does nothing if the snapshot is there.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if a block of those results is missing; a fault of the disk.
    pub fn make(
        &self,
        tip: &Tip,
        state: &State,
        (results, since): (&ResultStore, u64),
        complete: &mut Complete<'_>,
    ) -> Result<(), Rejection> {
        let _one = self.making.lock().unwrap_or_else(PoisonError::into_inner);
        if self.get(tip.height).is_some() {
            return Ok(());
        }
        let part = format!("{}.new", file::name(tip.height));
        build::build((&*self.disk, &part), self.network, (tip, state), (results, since), complete)?;
        self.keep(&part, tip.height).map(drop)
    }

    /// Gives a complete file its name, and drops the oldest if there are too many.
    fn keep(&self, part: &str, height: u64) -> Result<Arc<Snapshot>, Rejection> {
        let name = file::name(height);
        self.disk
            .rename(part, &name)
            .and_then(|()| self.disk.sync_dir())
            .map_err(|error| failed("rename", part, &error))?;
        let file = self.disk.open(&name).map_err(|error| failed("open", &name, &error))?;
        let snapshot = Arc::new(Snapshot::read(file, &name)?);
        let dropped: Vec<Arc<Snapshot>> = {
            let mut kept = self.kept.write().unwrap_or_else(PoisonError::into_inner);
            kept.retain(|other| other.manifest().height != height);
            kept.push(Arc::clone(&snapshot));
            kept.sort_by_key(|snapshot| snapshot.manifest().height);
            let pinned = self.pinned.load(Ordering::Relaxed);
            let is_loose = |snapshot: &Arc<Snapshot>| snapshot.manifest().height != pinned;
            let mut surplus = kept.iter().filter(|other| is_loose(other)).count().saturating_sub(SNAPSHOTS_KEPT);
            let goes = |other: &mut Arc<Snapshot>| {
                let goes = surplus > 0 && is_loose(other);
                surplus -= usize::from(goes);
                goes
            };
            kept.extract_if(.., goes).collect()
        };
        for dropped in &dropped {
            let name = file::name(dropped.manifest().height);
            if let Err(error) = self.disk.remove(&name) {
                tracing::warn!(%name, %error, "cannot remove an old snapshot");
            }
        }
        Ok(snapshot)
    }

    fn kept(&self) -> std::sync::RwLockReadGuard<'_, Vec<Arc<Snapshot>>> {
        self.kept.read().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A fault of a file as a refusal.
fn failed(operation: &str, name: &str, error: &io::Error) -> Rejection {
    let code = match error.kind() {
        ErrorKind::StorageFull => Code::DiskFull,
        _ => Code::DiskFailed,
    };
    Rejection::new(code, format!("cannot {operation} snapshots/{name}: {error}"))
}

fn damaged(name: &str, what: &str) -> Rejection {
    Rejection::new(Code::Corrupt, format!("the snapshot {name} is damaged: {what}"))
        .next("delete this snapshot; the node makes or fetches another one")
}
