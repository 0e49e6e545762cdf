//! The disk of the operating system.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Disk, DiskFile};

/// Name of the file whose lock says that a process has the directory open.
pub const LOCK_FILE: &str = "LOCK";

/// A directory of the operating system, locked against other processes for as long as this value lives.
#[derive(Debug)]
pub struct RealDisk {
    /// The directory.
    path: PathBuf,
    /// Whether files are opened for writing.
    writable: bool,
    /// Holds the lock; the kernel releases it when the process ends, however it ends.
    _lock: Option<File>,
}

impl RealDisk {
    /// Opens `path`, creating it if needed, for this process alone.
    ///
    /// Fails with [`ErrorKind::ResourceBusy`] when another process (or another value of this one) has it open.
    pub fn open(path: impl Into<PathBuf>) -> io::Result<Self> {
        let path = path.into();
        if !path.is_dir() {
            fs::create_dir_all(&path)?;
            if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
                File::open(parent)?.sync_all()?;
            }
        }
        let lock = OpenOptions::new().create(true).truncate(false).write(true).open(path.join(LOCK_FILE))?;
        lock.try_lock().map_err(|error| busy(&path, error))?;
        Ok(Self { path, writable: true, _lock: Some(lock) })
    }

    /// Opens an existing directory for reading only, for offline verification. Creates and changes nothing.
    ///
    /// Fails with [`ErrorKind::ResourceBusy`] while a node has the directory open for writing.
    pub fn open_read_only(path: impl Into<PathBuf>) -> io::Result<Self> {
        let Self { path, .. } = Self::open_beside_writer(path)?;
        let lock = match File::open(path.join(LOCK_FILE)) {
            Ok(lock) => {
                lock.try_lock_shared().map_err(|error| busy(&path, error))?;
                Some(lock)
            }
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        Ok(Self { path, writable: false, _lock: lock })
    }

    /// Opens an existing directory for reading only, beside a node that may be writing to it. Of a file that still
    /// changes, only the part that is known to be on the disk can be used. Any file may be removed meanwhile.
    pub fn open_beside_writer(path: impl Into<PathBuf>) -> io::Result<Self> {
        let path = path.into();
        if !fs::metadata(&path)?.is_dir() {
            return Err(io::Error::new(ErrorKind::NotADirectory, format!("{} is not a directory", path.display())));
        }
        Ok(Self { path, writable: false, _lock: None })
    }

    /// The directory.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn refuse_if_read_only(&self) -> io::Result<()> {
        if self.writable {
            return Ok(());
        }
        Err(io::Error::new(ErrorKind::ReadOnlyFilesystem, format!("{} is open for reading only", self.path.display())))
    }
}

impl Disk for RealDisk {
    fn open(&self, name: &str) -> io::Result<Arc<dyn DiskFile>> {
        let file = OpenOptions::new().read(true).write(self.writable).open(self.path.join(name))?;
        Ok(Arc::new(RealFile(file)))
    }

    fn create(&self, name: &str) -> io::Result<Arc<dyn DiskFile>> {
        self.refuse_if_read_only()?;
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(true);
        Ok(Arc::new(RealFile(options.open(self.path.join(name)).map_err(full)?)))
    }

    fn list(&self) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        for item in fs::read_dir(&self.path)? {
            let name = item?.file_name().to_string_lossy().into_owned();
            if name != LOCK_FILE {
                names.push(name);
            }
        }
        names.sort();
        Ok(names)
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        self.refuse_if_read_only()?;
        fs::rename(self.path.join(from), self.path.join(to))
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        self.refuse_if_read_only()?;
        fs::remove_file(self.path.join(name))
    }

    fn sync_dir(&self) -> io::Result<()> {
        File::open(&self.path)?.sync_all()
    }
}

/// Opens one file for reading only, wherever it is, without the lock of its directory.
///
/// # Errors
/// If it cannot be opened.
pub fn open_to_read(path: &Path) -> io::Result<Arc<dyn DiskFile>> {
    Ok(Arc::new(RealFile(File::open(path)?)))
}

/// A file of the operating system.
struct RealFile(File);

impl DiskFile for RealFile {
    fn read_at(&self, buf: &mut [u8], offset: u64) -> io::Result<usize> {
        let mut done = 0;
        while let Some(rest) = buf.get_mut(done..).filter(|rest| !rest.is_empty()) {
            match FileExt::read_at(&self.0, rest, offset.saturating_add(done as u64)) {
                Ok(0) => break,
                Ok(count) => done += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(done)
    }

    fn write_at(&self, buf: &[u8], offset: u64) -> io::Result<()> {
        self.0.write_all_at(buf, offset).map_err(full)
    }

    fn sync_data(&self) -> io::Result<()> {
        self.0.sync_data().map_err(full)
    }

    fn len(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }

    fn set_len(&self, bytes: u64) -> io::Result<()> {
        self.0.set_len(bytes)
    }
}

/// A quota that is used up is a full disk.
fn full(error: io::Error) -> io::Error {
    if error.kind() == ErrorKind::QuotaExceeded { ErrorKind::StorageFull.into() } else { error }
}

/// Turns a lock that somebody else holds into an error that says what to do.
fn busy(path: &Path, error: TryLockError) -> io::Error {
    match error {
        TryLockError::WouldBlock => io::Error::new(
            ErrorKind::ResourceBusy,
            format!("{} is in use by another process: stop that node first", path.display()),
        ),
        TryLockError::Error(error) => error,
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_directory_is_opened_by_one_only() {
        let dir = tempfile::tempdir().unwrap();
        let first = RealDisk::open(dir.path().join("store")).unwrap();
        let busy = RealDisk::open(first.path()).unwrap_err();
        assert_eq!(busy.kind(), ErrorKind::ResourceBusy);
        assert_eq!(RealDisk::open_read_only(first.path()).unwrap_err().kind(), ErrorKind::ResourceBusy);
        assert!(RealDisk::open_beside_writer(first.path()).unwrap().create("a").is_err());
        let path = first.path().to_owned();
        drop(first);
        RealDisk::open(path).unwrap();
    }

    #[test]
    fn files_keep_what_was_written_and_their_lock_is_not_listed() {
        let dir = tempfile::tempdir().unwrap();
        let disk = RealDisk::open(dir.path()).unwrap();
        let file = disk.create("a").unwrap();
        file.write_at(b"hello", 3).unwrap();
        file.sync_data().unwrap();
        disk.rename("a", "b").unwrap();
        disk.sync_dir().unwrap();
        assert_eq!(disk.list().unwrap(), ["b"]);
        let mut buf = [1; 16];
        assert_eq!(disk.open("b").unwrap().read_at(&mut buf, 1).unwrap(), 7);
        assert_eq!(buf.get(..7).unwrap(), b"\0\0hello");
        file.set_len(4).unwrap();
        assert_eq!(file.len().unwrap(), 4);
        disk.remove("b").unwrap();
        assert!(disk.list().unwrap().is_empty());
    }

    #[test]
    fn a_directory_open_for_reading_is_not_changed() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("a"), b"x").unwrap();
        let disk = RealDisk::open_read_only(dir.path()).unwrap();
        assert!(disk.create("b").is_err() && disk.remove("a").is_err() && disk.rename("a", "b").is_err());
        assert!(disk.open("a").unwrap().write_at(b"y", 0).is_err());
        assert_eq!(disk.list().unwrap(), ["a"]);
    }
}
