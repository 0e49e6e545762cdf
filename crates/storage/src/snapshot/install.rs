//! Taking a snapshot from elsewhere.

use super::manifest::Manifest;
use super::{Snapshot, Snapshots, damaged, failed, file};
use crate::disk::DiskFile;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::io::ErrorKind;
use std::sync::{Arc, MutexGuard, PoisonError};

/// Gathers the chunks of a snapshot, each compared with the manifest, in a file beside the snapshots. The present
/// content of that file is used, so that it continues after a crash.
pub struct Installer<'a> {
    snapshots: &'a Snapshots,
    _one: MutexGuard<'a, ()>,
    manifest: Manifest,
    file: Arc<dyn DiskFile>,
    name: String,
    /// Chunks that are there, from the first on.
    have: usize,
}

impl<'a> Installer<'a> {
    pub(super) fn begin(snapshots: &'a Snapshots, manifest: Manifest) -> Result<Self, Rejection> {
        let one = snapshots.fetching.lock().unwrap_or_else(PoisonError::into_inner);
        let name = format!("{}.part", file::name(manifest.height));
        // Those of other heights will not be continued.
        for other in snapshots.disk.list().map_err(|error| failed("list", "", &error))? {
            if other.ends_with(".part") && other != name {
                snapshots.disk.remove(&other).map_err(|error| failed("remove", &other, &error))?;
            }
        }
        let opened = match snapshots.disk.open(&name) {
            Err(error) if error.kind() == ErrorKind::NotFound => snapshots.disk.create(&name),
            opened => opened,
        };
        let file = opened.map_err(|error| failed("open", &name, &error))?;
        let mut have = 0;
        while have < manifest.chunks.len() && file::read_chunk(&*file, &name, &manifest, have)?.is_some() {
            have += 1;
        }
        Ok(Self { snapshots, _one: one, manifest, file, name, have })
    }

    /// The manifest of the snapshot that is gathered.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Number of the chunk that is wanted next, from 0; none if all are there.
    pub fn wanted(&self) -> Option<usize> {
        (self.have < self.manifest.chunks.len()).then_some(self.have)
    }

    /// Takes the chunk that is wanted next.
    ///
    /// # Errors
    /// [`Code::Malformed`] if it is not what the manifest says: ask another node. A fault of the disk.
    pub fn put(&mut self, bytes: &[u8]) -> Result<(), Rejection> {
        let wanted = self.manifest.chunks.get(self.have).copied();
        let fits = wanted.is_some_and(|chunk| bytes.len() == chunk.bytes as usize && Hash::of(&[bytes]) == chunk.hash);
        if !fits {
            let what = format!("chunk {} of a snapshot does not match its manifest", self.have);
            return Err(Rejection::new(Code::Malformed, what)
                .found(format!("{} bytes with SHA-256 {}", bytes.len(), Hash::of(&[bytes])))
                .wanted(wanted.map_or("no more chunks".into(), |chunk| {
                    format!("{} bytes with SHA-256 {}", chunk.bytes, chunk.hash)
                }))
                .next("fetch it from another node"));
        }
        let written = self.file.write_at(bytes, file::offset(self.have));
        written.map_err(|error| failed("write", &self.name, &error))?;
        self.have += 1;
        Ok(())
    }

    /// All chunks are there: makes the file whole, for looking into it. Only [`accept`](Self::accept) makes it one of
    /// this node's snapshots.
    ///
    /// # Errors
    /// [`Code::Internal`] if chunks are missing; a fault of the disk.
    pub fn complete(&self) -> Result<Snapshot, Rejection> {
        if let Some(wanted) = self.wanted() {
            return Err(Rejection::new(Code::Internal, format!("chunk {wanted} of a snapshot is missing")));
        }
        let (at, end) = (file::HEAD_BYTES + self.manifest.bytes(), file::end(&self.manifest));
        let written = self
            .file
            .write_at(&file::head(), 0)
            .and_then(|()| self.file.write_at(&end, at))
            .and_then(|()| self.file.set_len(at + end.len() as u64))
            .and_then(|()| self.file.sync_data());
        written.map_err(|error| failed("write", &self.name, &error))?;
        let snapshot = Snapshot::read(Arc::clone(&self.file), &self.name)?;
        if snapshot.manifest() != &self.manifest {
            return Err(damaged(&self.name, "it differs from what was written"));
        }
        Ok(snapshot)
    }

    /// Makes the complete snapshot one of this node's.
    ///
    /// # Errors
    /// As [`complete`](Self::complete).
    pub fn accept(self) -> Result<Arc<Snapshot>, Rejection> {
        self.complete()?;
        self.snapshots.keep(&self.name, self.manifest.height)
    }

    /// Forgets what was gathered: nobody whom this node trusts has signed it.
    ///
    /// # Errors
    /// A fault of the disk.
    pub fn discard(self) -> Result<(), Rejection> {
        self.snapshots.disk.remove(&self.name).map_err(|error| failed("remove", &self.name, &error))
    }
}
