//! The file of a recording. A part that cannot be written whole is taken back, so that the file ends with a whole chunk.

use ledger_base::rejection::{Code, Rejection};
use mcap::McapError;
use std::cell::RefCell;
use std::error::Error;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// The file, shared by the writer of MCAP and by the recording that has to care for its end.
#[derive(Clone)]
pub(super) struct Disk(Rc<RefCell<Open>>);

struct Open {
    path: PathBuf,
    /// None once a write has failed: what is buffered then shall not come behind the cut.
    file: Option<BufWriter<File>>,
    /// Bytes given to it.
    written: u64,
    /// Bytes up to the end of the last whole chunk.
    whole: u64,
}

impl Disk {
    /// Creates the file.
    pub(super) fn create(path: &Path, replace: bool) -> Result<Self, Rejection> {
        let mut options = File::options();
        options.write(true);
        if replace {
            options.create(true).truncate(true);
        } else {
            options.create_new(true);
        }
        let file = options.open(path).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => taken(path),
            _ => unwritable(path, &error).next("write to another directory, or mend its rights"),
        })?;
        let file = Some(BufWriter::new(file));
        Ok(Self(Rc::new(RefCell::new(Open { path: path.to_owned(), file, written: 0, whole: 0 }))))
    }

    /// Bytes given to it.
    pub(super) fn written(&self) -> u64 {
        self.0.borrow().written
    }

    /// Notes that it ends with a whole chunk now.
    pub(super) fn mark(&self) {
        let mut open = self.0.borrow_mut();
        open.whole = open.written;
    }

    /// Waits until the disk has it all. Answers with the length.
    pub(super) fn sync(&self) -> Result<u64, Rejection> {
        let mut open = self.0.borrow_mut();
        let synced = open.file().and_then(|file| {
            file.flush()?;
            file.get_ref().sync_all()
        });
        synced.map_err(|error| unwritable(&open.path, &error).next(RECOVER))?;
        Ok(open.written)
    }

    /// The refusal of a write. The file is cut behind its last whole chunk.
    pub(super) fn refused(&self, error: &McapError) -> Rejection {
        let mut open = self.0.borrow_mut();
        let cut = open.file.take().is_some_and(|file| file.into_parts().0.set_len(open.whole).is_ok());
        let kept = if cut && open.whole > 0 { RECOVER } else { "record it again where there is room" };
        unwritable(&open.path, &cause(error)).next(kept)
    }
}

/// The advice for a file without an end.
const RECOVER: &str =
    "make room; the file has everything up to the last second: mcap recover FILE writes the index that it lacks";

impl Open {
    fn file(&mut self) -> io::Result<&mut BufWriter<File>> {
        self.file.as_mut().ok_or_else(|| io::Error::other("a write before this one has failed"))
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut open = self.0.borrow_mut();
        let count = open.file()?.write(bytes)?;
        open.written = open.written.saturating_add(count as u64);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.borrow_mut().file()?.flush()
    }
}

/// The refusal of a name that is taken.
pub(crate) fn taken(path: &Path) -> Rejection {
    Rejection::new(Code::AlreadyExists, format!("{} exists already", path.display()))
        .found("a file of this name")
        .wanted("a name that is free: a recording replaces nothing unasked")
        .next("choose another name, or --force if that file may be lost")
}

/// The innermost error: that of the disk, if it has failed.
fn cause(error: &McapError) -> String {
    let mut inner: &dyn Error = error;
    while let Some(next) = inner.source() {
        inner = next;
    }
    inner.to_string()
}

fn unwritable(path: &Path, error: &dyn std::fmt::Display) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot write {}", path.display()))
        .found(error.to_string())
        .wanted("a file that this user may create, on a disk with room")
}
