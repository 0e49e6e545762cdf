//! Certificates of long ago: about one in ten seconds of block time is kept with the ground of its block, as long as blocks are.
//!
//! Each proves all blocks before it, by their headers, and their verdicts, by their effects. Files hold some 4 MiB of records, `length u32 BE` and the bytes of a
//! proof. They are named by the height of the first one, `HEIGHT.passed` with 20 digits. A torn record at the end of a file, which
//! a crash may leave, ends what is read of it. Each start begins a new file.

use ledger_base::durable::failed;
use ledger_base::rejection::Rejection;
use ledger_light::proof::PROOF_BYTES_MAX;
use ledger_light::{Proof, Statement};
use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Block time between two of them, microseconds.
pub(super) const EVERY_US: u64 = 10_000_000;
/// A file of this size is finished.
const FILE_BYTES: u64 = 4 * 1024 * 1024;
const SUFFIX: &str = ".passed";

/// The files.
pub(super) struct Passed {
    directory: PathBuf,
    inner: Mutex<Files>,
}

#[derive(Default)]
struct Files {
    /// Heights of the first record of each.
    first: BTreeSet<u64>,
    open: Option<(File, u64)>,
    /// Height and block time of the last record, as far as this run knows.
    last: (u64, u64),
}

impl Passed {
    /// Those in a directory.
    pub(super) fn open(directory: &Path) -> Result<Self, Rejection> {
        let unreadable = |error| failed("list", directory, &error);
        let mut files = Files::default();
        for entry in std::fs::read_dir(directory).map_err(unreadable)? {
            let name = entry.map_err(unreadable)?.file_name();
            let stem = name.to_str().and_then(|name| name.strip_suffix(SUFFIX));
            files.first.extend(stem.and_then(|stem| stem.parse::<u64>().ok()));
        }
        Ok(Self { directory: directory.to_owned(), inner: Mutex::new(files) })
    }

    /// Is one of that height and block time to be kept?
    pub(super) fn wants(&self, height: u64, time: u64) -> bool {
        let (last, at) = self.lock().last;
        height > last && time >= at.saturating_add(EVERY_US)
    }

    /// Keeps the proof of a block. Blocks before `first` are dropped, and with them what proves no other.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn keep(&self, proof: &Proof, first: u64) -> Result<(), Rejection> {
        let Statement { height, time, .. } = proof.certificate.statement;
        let mut files = self.lock();
        files.last = (height, time);
        if files.open.as_ref().is_none_or(|(_, size)| *size >= FILE_BYTES) {
            files.open = None;
            let path = self.path(height);
            let file = OpenOptions::new().create(true).write(true).truncate(true).open(&path);
            files.open = Some((file.map_err(|error| failed("create", &path, &error))?, 0));
            files.first.insert(height);
            self.drop_old(&mut files, first)?;
        }
        let bytes = proof.to_bytes();
        let record = [&(bytes.len() as u32).to_be_bytes()[..], &bytes].concat();
        let Some((file, size)) = &mut files.open else { return Ok(()) };
        *size += record.len() as u64;
        let written = file.write_all(&record);
        if written.is_err() {
            // Whatever of it is in the file is the torn end.
            files.open = None;
        }
        written.map_err(|error| failed("write", &self.directory, &error))
    }

    /// The first proof of a block at or after a height.
    ///
    /// # Errors
    /// A fault of the disk.
    pub(super) fn at_or_after(&self, height: u64) -> Result<Option<Proof>, Rejection> {
        let first = self.lock().first.clone();
        let begin = first.range(..=height).next_back().copied().unwrap_or(0);
        for file in first.range(begin..) {
            let path = self.path(*file);
            let bytes = match std::fs::read(&path) {
                // It was dropped just now.
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
                read => read.map_err(|error| failed("read", &path, &error))?,
            };
            let found = records(&bytes).find(|proof| proof.certificate.statement.height >= height);
            if found.is_some() {
                return Ok(found);
            }
        }
        Ok(None)
    }

    /// Drops files of which all blocks are below a height.
    fn drop_old(&self, files: &mut Files, keep_from: u64) -> Result<(), Rejection> {
        while let Some((oldest, next)) = files.first.first().copied().zip(files.first.iter().nth(1).copied()) {
            if next >= keep_from {
                break;
            }
            let path = self.path(oldest);
            match std::fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(failed("remove", &path, &error));
                }
                _ => drop(files.first.remove(&oldest)),
            }
        }
        Ok(())
    }

    fn path(&self, height: u64) -> PathBuf {
        self.directory.join(format!("{height:020}{SUFFIX}"))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Files> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The proofs of a file, up to whatever is none.
fn records(bytes: &[u8]) -> impl Iterator<Item = Proof> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        let (length, after) = rest.split_first_chunk()?;
        let length = u32::from_be_bytes(*length) as usize;
        if length > PROOF_BYTES_MAX {
            return None;
        }
        let (proof, after) = after.split_at_checked(length)?;
        rest = after;
        Proof::from_bytes(proof).ok()
    })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;
    use ledger_light::Certificate;

    fn proof(height: u64) -> Proof {
        let statement = Statement {
            network: Hash::ZERO,
            recoveries: 0,
            height,
            time: height * EVERY_US,
            block: Hash::ZERO,
            results: Hash::ZERO,
        };
        Proof { certificate: Certificate { statement, signatures: Vec::new() }, facts: Vec::new() }
    }

    fn found(passed: &Passed, height: u64) -> Option<u64> {
        passed.at_or_after(height).unwrap().map(|proof| proof.certificate.statement.height)
    }

    #[test]
    fn the_next_certificate_after_a_height_is_found_also_after_a_start_and_a_torn_write() {
        let place = tempfile::tempdir().unwrap();
        let passed = Passed::open(place.path()).unwrap();
        for height in [3, 5, 9] {
            assert!(passed.wants(height, height * EVERY_US));
            passed.keep(&proof(height), 0).unwrap();
        }
        assert!(!passed.wants(10, 9 * EVERY_US + 1) && !passed.wants(9, 99 * EVERY_US));
        let file = passed.path(3);
        let whole = std::fs::read(&file).unwrap();
        std::fs::write(&file, &whole[..whole.len() - 1]).unwrap();
        let again = Passed::open(place.path()).unwrap();
        again.keep(&proof(12), 0).unwrap();
        for (height, wanted) in [(0, Some(3)), (3, Some(3)), (4, Some(5)), (6, Some(12)), (12, Some(12)), (13, None)] {
            assert_eq!(found(&again, height), wanted, "{height}");
        }
        let third = Passed::open(place.path()).unwrap();
        third.keep(&proof(20), 13).unwrap();
        assert_eq!(
            (found(&third, 0), file.exists()),
            (Some(12), false),
            "what proves no block that is kept is dropped"
        );
    }
}
