//! The heights that voters have confirmed, in a file: a voter whose disk was set back is noticed also after a restart.

use crate::storage::files::CONFIRMED_FILE;
use ledger_base::durable::{PUBLIC_MODE, read, replace};
use ledger_raft::Receipt;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Largest such file, in bytes.
const CONFIRMED_BYTES_MAX: usize = 64 * 1024;
/// Time between two writes.
const WRITE_EVERY: Duration = Duration::from_secs(10);

/// The heights in the file of this data directory, for an operator; nothing if it is missing or cannot be read.
pub(crate) fn confirmed_heights(data: &Path) -> BTreeMap<u64, u64> {
    let read = Confirmed::of(data.to_owned()).read();
    read.into_iter().map(|(id, receipt)| (id, receipt.index)).collect()
}

/// One voter in the file.
#[derive(Serialize, Deserialize)]
struct Entry {
    height: u64,
    /// The authentication code of its receipt, in hexadecimal digits; empty if it gave none.
    receipt: String,
}

/// The file.
pub(super) struct Confirmed {
    path: PathBuf,
    written: Mutex<(Option<Instant>, BTreeMap<u64, Receipt>)>,
}

impl Confirmed {
    /// In this data directory.
    pub(super) fn of(data: PathBuf) -> Self {
        Self { path: data.join(CONFIRMED_FILE), written: Mutex::default() }
    }

    /// Its content; nothing if it is missing or cannot be read, as it only adds to what other nodes know.
    pub(super) fn read(&self) -> BTreeMap<u64, Receipt> {
        if !self.path.exists() {
            return BTreeMap::new();
        }
        let read = read(&self.path, CONFIRMED_BYTES_MAX).map_err(|fault| fault.to_string());
        let parsed = read.and_then(|bytes| serde_json::from_slice(&bytes).map_err(|error| error.to_string()));
        let receipt = |Entry { height, receipt }| {
            let code = hex::decode(receipt).map_err(|error| error.to_string())?;
            Ok::<_, String>(Receipt { term: 0, index: height, code: code.into() })
        };
        let receipts = parsed.and_then(|entries: BTreeMap<u64, Entry>| {
            entries.into_iter().map(|(id, entry)| Ok((id, receipt(entry)?))).collect()
        });
        receipts.unwrap_or_else(|reason| {
            tracing::warn!(file = %self.path.display(), reason, "cannot read the heights that voters confirmed; \
                                                                 discarding them");
            BTreeMap::new()
        })
    }

    /// Writes it, if that is worth a write.
    pub(super) fn write(&self, confirmed: &BTreeMap<u64, Receipt>) {
        let mut written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        let (at, before) = &*written;
        if before == confirmed || at.is_some_and(|at| at.elapsed() < WRITE_EVERY) {
            return;
        }
        let entry = |receipt: &Receipt| Entry { height: receipt.index, receipt: hex::encode(&receipt.code) };
        let entries: BTreeMap<_, _> = confirmed.iter().map(|(id, receipt)| (id, entry(receipt))).collect();
        let wrote = serde_json::to_vec(&entries).map_err(|error| error.to_string());
        let wrote = wrote.and_then(|bytes| replace(&self.path, &bytes, PUBLIC_MODE).map_err(|fault| fault.to_string()));
        match wrote {
            Ok(()) => *written = (Some(Instant::now()), confirmed.clone()),
            Err(reason) => tracing::debug!(reason, "cannot store the heights that voters confirmed; retrying"),
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn what_voters_confirmed_is_there_after_a_restart_and_a_damaged_file_is_not_believed() {
        let place = tempfile::tempdir().unwrap();
        let receipt = |index, code: &'static [u8]| Receipt { term: 0, index, code: code.into() };
        let confirmed = BTreeMap::from([(1, receipt(200, &[7, 8])), (3, receipt(150, &[]))]);
        assert_eq!(Confirmed::of(place.path().to_owned()).read(), BTreeMap::new());
        Confirmed::of(place.path().to_owned()).write(&confirmed);
        assert_eq!(Confirmed::of(place.path().to_owned()).read(), confirmed);
        std::fs::write(place.path().join(CONFIRMED_FILE), "{\"1\":").unwrap();
        assert_eq!(Confirmed::of(place.path().to_owned()).read(), BTreeMap::new());
    }
}
