//! The calls that decide what a crash leaves; a test's disk forgets what these calls do not make last.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

pub(crate) trait Medium {
    type File: Write;
    fn create_new(&self, path: &Path, mode: u32) -> io::Result<Self::File>;
    fn sync(&self, file: &Self::File) -> io::Result<()>;
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    fn remove(&self, path: &Path) -> io::Result<()>;
    fn sync_directory(&self, path: &Path) -> io::Result<()>;
}

/// The disk of the machine.
pub(crate) struct Real;

impl Medium for Real {
    type File = File;

    fn create_new(&self, path: &Path, mode: u32) -> io::Result<File> {
        OpenOptions::new().write(true).create_new(true).mode(mode).open(path)
    }

    fn sync(&self, file: &File) -> io::Result<()> {
        file.sync_all()
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn sync_directory(&self, path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }
}

#[cfg(test)]
pub(crate) mod forgetful {
    //! A disk that keeps what was synced; of the rest a crash leaves as little as it may, or the names without the bytes.

    use super::Medium;
    use std::cell::RefCell;
    use std::collections::BTreeMap;
    use std::io::{self, Write};
    use std::path::{Path, PathBuf};
    use std::rc::Rc;

    /// The bytes of a file in memory, and those on the disk.
    #[derive(Clone, Default)]
    struct Bytes {
        written: Vec<u8>,
        synced: Vec<u8>,
    }

    type Inode = Rc<RefCell<Bytes>>;
    /// The inodes that paths name.
    type Names = BTreeMap<PathBuf, Inode>;

    /// The contents of files after a crash.
    type Left = BTreeMap<PathBuf, Vec<u8>>;

    #[derive(Default)]
    pub(crate) struct Forgetful {
        /// Names as programs see them.
        names: RefCell<Names>,
        /// Names on the disk.
        synced: RefCell<Names>,
        /// The files that a crash may leave after each step: with the names on the disk, and with those in memory.
        history: RefCell<Vec<[Left; 2]>>,
    }

    pub(crate) struct Open(Inode);

    impl Write for Open {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.borrow_mut().written.extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Forgetful {
        fn step(&self) {
            let left = |names: &RefCell<Names>| {
                names.borrow().iter().map(|(path, inode)| (path.clone(), inode.borrow().synced.clone())).collect()
            };
            self.history.borrow_mut().push([left(&self.synced), left(&self.names)]);
        }

        pub(crate) fn forget_history(&self) {
            self.history.borrow_mut().clear();
        }

        /// The least that a crash leaves of a file now.
        pub(crate) fn after_a_crash(&self, path: &str) -> Option<Vec<u8>> {
            self.synced.borrow().get(Path::new(path)).map(|inode| inode.borrow().synced.clone())
        }

        /// The contents that a crash after each step may have left of a file.
        pub(crate) fn after_each_step(&self, path: &str) -> Vec<Option<Vec<u8>>> {
            self.history.borrow().iter().flatten().map(|left| left.get(Path::new(path)).cloned()).collect()
        }
    }

    impl Medium for Forgetful {
        type File = Open;

        fn create_new(&self, path: &Path, _mode: u32) -> io::Result<Open> {
            let inode = Inode::default();
            self.names.borrow_mut().insert(path.to_owned(), Rc::clone(&inode));
            self.step();
            Ok(Open(inode))
        }

        fn sync(&self, file: &Open) -> io::Result<()> {
            let written = file.0.borrow().written.clone();
            file.0.borrow_mut().synced = written;
            self.step();
            Ok(())
        }

        fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
            let inode = self.names.borrow_mut().remove(from).ok_or(io::ErrorKind::NotFound)?;
            self.names.borrow_mut().insert(to.to_owned(), inode);
            self.step();
            Ok(())
        }

        fn remove(&self, path: &Path) -> io::Result<()> {
            self.names.borrow_mut().remove(path).map(drop).ok_or(io::ErrorKind::NotFound)?;
            self.step();
            Ok(())
        }

        fn sync_directory(&self, directory: &Path) -> io::Result<()> {
            let inside = |path: &PathBuf| path.parent() == Some(directory);
            let mut synced = self.synced.borrow_mut();
            synced.retain(|path, _| !inside(path));
            synced.extend(
                self.names.borrow().iter().filter(|(path, _)| inside(path)).map(|(p, i)| (p.clone(), Rc::clone(i))),
            );
            drop(synced);
            self.step();
            Ok(())
        }
    }
}
