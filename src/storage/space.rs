//! The disk of the data directory, whose space [`ledger_replica::space`] judges.

mod reserve;

use ledger_base::rejection::Rejection;
use ledger_replica::space::{self, Accepts, Ground, Measured, Reserve, Wrote};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// The space of a node's disk.
pub(crate) struct Space {
    data: PathBuf,
    judged: Mutex<(space::Space, DataDisk)>,
    /// Not everything is accepted. Read for each call and each write, so without a lock.
    full: AtomicBool,
    /// Bytes a second that are accepted of one organisation; read as `full` is.
    organisation_bytes: AtomicU64,
}

/// The disk that a data directory is on.
struct DataDisk {
    data: PathBuf,
    reserve: reserve::File,
}

/// Gives up the reserve of a data directory before its stores are open; true if there was one. A store writes when it is opened.
pub(crate) fn give_up_reserve(data: &Path) -> bool {
    reserve::File::of(data).give_up()
}

impl Space {
    /// Looks at the disk of a data directory, and lays the reserve in it.
    pub(crate) fn open(data: &Path) -> Self {
        let data = std::path::absolute(data).unwrap_or_else(|_| data.to_owned());
        let mut disk = DataDisk { reserve: reserve::File::of(&data), data: data.clone() };
        let judged = space::Space::of(data.display().to_string(), &mut disk);
        let full = AtomicBool::new(judged.is_full());
        let organisation_bytes = AtomicU64::new(judged.organisation_bytes());
        Self { data, judged: Mutex::new((judged, disk)), full, organisation_bytes }
    }

    /// Looks again: takes note of what is accepted from now on, and says what has changed.
    pub(crate) fn look(&self) {
        self.with(|space, disk| space.look(disk));
    }

    /// Takes note of a write of the log. True if it is to be tried again at once.
    pub(crate) fn wrote(&self, wrote: Wrote) -> bool {
        // On a disk with room it is as usual.
        let usual = wrote == Wrote::All && !self.is_full();
        !usual && self.with(|space, disk| space.wrote(disk, wrote))
    }

    /// Is there too little for messages, and for what can wait?
    pub(crate) fn is_full(&self) -> bool {
        self.full.load(Ordering::Relaxed)
    }

    /// Bytes of transactions a second that are accepted of one organisation.
    pub(crate) fn organisation_bytes(&self) -> u64 {
        self.organisation_bytes.load(Ordering::Relaxed)
    }

    /// The calls that are accepted now.
    pub(crate) fn accepts(&self) -> Accepts {
        self.with(|space, _| space.accepts())
    }

    /// The finding of the last look.
    pub(crate) fn measured(&self) -> Measured {
        self.with(|space, _| space.measured())
    }

    /// The directory whose disk this is.
    pub(crate) fn data(&self) -> &Path {
        &self.data
    }

    /// Why a call is not accepted, if it is not.
    ///
    /// # Errors
    /// As [`space::Space::check`].
    pub(crate) fn check(&self, ends: impl FnOnce() -> bool) -> Result<(), Rejection> {
        if self.is_full() { self.with(|space, _| space.check(ends)) } else { Ok(()) }
    }

    fn with<T>(&self, act: impl FnOnce(&mut space::Space, &mut DataDisk) -> T) -> T {
        let mut judged = self.judged.lock().unwrap_or_else(PoisonError::into_inner);
        let (space, disk) = &mut *judged;
        let done = act(space, disk);
        self.full.store(space.is_full(), Ordering::Relaxed);
        self.organisation_bytes.store(space.organisation_bytes(), Ordering::Relaxed);
        done
    }
}

impl Ground for DataDisk {
    fn measure(&mut self) -> Option<Measured> {
        let found = rustix::fs::statvfs(&self.data);
        if let Err(error) = &found {
            tracing::debug!(%error, "cannot determine the free disk space");
        }
        let found = found.ok()?;
        let size = |blocks: u64| blocks.saturating_mul(found.f_frsize);
        Some(Measured { free: size(found.f_bavail), total: size(found.f_blocks) })
    }

    fn reserve(&self) -> Reserve {
        self.reserve.state()
    }

    fn lay(&mut self) {
        self.reserve.lay();
    }

    fn give_up(&mut self) -> bool {
        self.reserve.give_up()
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::rejection::Code;

    #[test]
    fn the_reserve_takes_its_place_and_gives_it_back() {
        let directory = tempfile::tempdir().unwrap();
        let space = Space::open(directory.path());
        assert_eq!(space.accepts(), Accepts::All, "this test needs a disk with some space");
        let laid = std::fs::metadata(directory.path().join(reserve::FILE)).unwrap();
        assert_eq!(laid.len(), space::RESERVE_BYTES);
        assert!(std::os::unix::fs::MetadataExt::blocks(&laid) * 512 >= space::RESERVE_BYTES, "no holes");
        assert!(space.wrote(Wrote::NoRoom) && !space.wrote(Wrote::NoRoom), "it is given up once");
        assert!(space.check(|| true).is_ok());
        let refused = space.check(|| false).unwrap_err();
        assert!(refused.code == Code::DiskFull && refused.found.contains("free"), "{refused}");
        assert!(!space.wrote(Wrote::All));
        space.look();
        assert_eq!(space.accepts(), Accepts::All);
        assert_eq!(std::fs::metadata(directory.path().join(reserve::FILE)).unwrap().len(), space::RESERVE_BYTES);
    }
}
