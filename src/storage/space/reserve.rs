//! A file that keeps a place on the disk.

use ledger_replica::space::{RESERVE_BYTES, Reserve};
use std::fs;
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The file, in the data directory. Its content means nothing.
pub(super) const FILE: &str = "reserve";
/// Bytes of a block as `stat` counts them.
const STAT_BLOCK_BYTES: u64 = 512;
/// Written at once where the file system does not give a place without.
const PIECE_BYTES: usize = 1 << 20;

/// The reserve of a data directory.
pub(super) struct File {
    path: PathBuf,
    state: Reserve,
}

impl File {
    /// The reserve that an earlier run has left, or none yet.
    pub(super) fn of(data: &Path) -> Self {
        let path = data.join(FILE);
        let whole =
            |file: fs::Metadata| file.len() == RESERVE_BYTES && file.blocks() * STAT_BLOCK_BYTES >= RESERVE_BYTES;
        let state = if fs::symlink_metadata(&path).is_ok_and(whole) { Reserve::Laid } else { Reserve::Missing };
        Self { path, state }
    }

    /// Is it there, and can it be?
    pub(super) fn state(&self) -> Reserve {
        self.state
    }

    /// Takes the place.
    pub(super) fn lay(&mut self) {
        let laid = fs::remove_file(&self.path).or_else(absent).and_then(|()| take(&self.path));
        self.state = match laid {
            Ok(()) => Reserve::Laid,
            Err(error) => {
                let _ = fs::remove_file(&self.path);
                if matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded) {
                    Reserve::Missing
                } else {
                    tracing::warn!(path = %self.path.display(), %error, "cannot allocate the reserve of disk space");
                    Reserve::Impossible
                }
            }
        };
    }

    /// Gives the place back; true if there was one.
    pub(super) fn give_up(&mut self) -> bool {
        if self.state != Reserve::Laid {
            return false;
        }
        let given = fs::remove_file(&self.path).or_else(absent);
        if let Err(error) = &given {
            tracing::warn!(path = %self.path.display(), %error, "cannot release the reserve of disk space");
        }
        self.state = Reserve::Missing;
        given.is_ok()
    }
}

fn absent(error: io::Error) -> io::Result<()> {
    if error.kind() == ErrorKind::NotFound { Ok(()) } else { Err(error) }
}

/// Makes the file without holes, as a hole keeps no place.
fn take(path: &Path) -> io::Result<()> {
    let mut file = fs::File::create_new(path)?;
    match rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, RESERVE_BYTES) {
        Err(rustix::io::Errno::OPNOTSUPP | rustix::io::Errno::NOSYS) => {
            let mut left = RESERVE_BYTES;
            while left > 0 {
                let piece = usize::try_from(left).unwrap_or(PIECE_BYTES).min(PIECE_BYTES);
                file.write_all(vec![0; piece].as_slice())?;
                left -= piece as u64;
            }
            file.sync_data()
        }
        given => Ok(given?),
    }
}
