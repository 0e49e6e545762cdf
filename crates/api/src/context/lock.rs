//! One program at a time changes contexts, and nobody reads one that is half changed.

use ledger_base::rejection::{Code, Rejection};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

/// The file that is locked, beside the directory of the contexts.
const FILE: &str = ".lock";
/// How long a reader waits for a writer. A change takes a few writes to the disk; a writer that takes longer was stopped, and
/// a context is then read as it is.
const READER_WAITS_MAX: Duration = Duration::from_secs(1);
/// How long a writer waits for others.
const WRITER_WAITS_MAX: Duration = Duration::from_secs(10);
/// Between two looks.
const LOOK: Duration = Duration::from_millis(5);

/// Held as long as contexts are read or changed. The system releases it with the process, however that ends.
pub(super) struct Lock {
    _file: Option<File>,
}

impl Lock {
    /// For reading, beside other readers. Where nobody has ever written, or nobody may, there is nothing to wait for.
    pub(super) fn shared(home: &Path) -> Self {
        let file = File::open(home.join(FILE)).ok();
        let held = file.filter(|file| wait(READER_WAITS_MAX, || file.try_lock_shared().is_ok()));
        Self { _file: held }
    }

    /// For changing, alone.
    ///
    /// # Errors
    /// [`Code::BadFile`] if the place cannot be written, or another program does not finish its change.
    pub(super) fn exclusive(home: &Path) -> Result<Self, Rejection> {
        Self::exclusive_within(home, WRITER_WAITS_MAX)
    }

    /// As [`Lock::exclusive`], for a change that can be made another time.
    ///
    /// # Errors
    /// As [`Lock::exclusive`].
    pub(super) fn exclusive_within(home: &Path, patience: Duration) -> Result<Self, Rejection> {
        let path = home.join(FILE);
        let failed = |error: io::Error| super::files::unwritable(&path, &error);
        let file = OpenOptions::new().create(true).truncate(false).write(true).mode(0o600).open(&path);
        let file = file.map_err(failed)?;
        if wait(patience, || file.try_lock().is_ok()) {
            return Ok(Self { _file: Some(file) });
        }
        Err(Rejection::new(Code::BadFile, format!("another program is changing the contexts in {}", home.display()))
            .found(format!("a lock on {}", path.display()))
            .wanted("one change at a time")
            .next(format!("wait for that program, or end it: fuser {}", path.display())))
    }
}

/// Asks until it is so, or the patience ends.
fn wait(patience: Duration, mut so: impl FnMut() -> bool) -> bool {
    let deadline = Instant::now() + patience;
    loop {
        if so() {
            return true;
        }
        if Instant::now() >= deadline {
            return false;
        }
        std::thread::sleep(LOOK);
    }
}
