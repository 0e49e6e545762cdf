//! Segments that are cut or rotten, as the store finds them when it opens: thousands of copies of a real log.

use super::History;
use crate::rounds;
use crate::support::Dice;
use ledger::block_store::{BlockStore, Options, StoreError};
use ledger::disk::{Disk, SimDisk};
use ledger::entry::Entry;
use ledger::segment::{Found, HEADER_BYTES, LogPosition, Record, scan};
use std::path::PathBuf;
use std::sync::Arc;

/// Unit in which disks rot.
const SECTOR_BYTES: usize = 512;
/// Records at the end of the log that are cut at every byte.
const RECORDS_CUT: usize = 3;
/// In segments before the newest, a bit is flipped in one of so many sectors; with more rounds, in all of them.
const OLD_SECTORS_STEP: usize = 16;
/// Sectors behind the end of the log in which a bit is flipped.
const EMPTY_SECTORS: usize = 20;

/// A record and where it stands.
struct Placed {
    file: usize,
    start: usize,
    end: usize,
    durable_upto: LogPosition,
    position: LogPosition,
    record: Record,
}

/// A log as a killed node left it.
struct Log {
    network: [u8; 32],
    /// Names and contents of the segments in order.
    files: Vec<(String, Vec<u8>)>,
    records: Vec<Placed>,
}

/// What became of a damaged log.
#[derive(Default)]
struct Outcomes {
    repaired: u64,
    refused: u64,
}

impl Log {
    fn read(network: [u8; 32], segments: &[PathBuf]) -> Self {
        let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        let mut files: Vec<_> = segments.iter().map(|path| (name(path), std::fs::read(path).unwrap())).collect();
        let disk = disk(&files);
        let mut records = Vec::new();
        for found in scan(disk.as_ref(), Some(&network)).unwrap() {
            let Found::Record { file, position, bytes, durable_upto, record } = found.unwrap() else { continue };
            let (start, file) = (position.offset as usize, files.iter().position(|(name, _)| **name == *file).unwrap());
            records.push(Placed { file, start, end: start + bytes as usize, durable_upto, position, record });
        }
        // Most of the newest segment is zeros that were written ahead; a few sectors of them will do.
        let end: usize = records.last().map_or(0, |last: &Placed| last.end);
        files.last_mut().unwrap().1.truncate((end.div_ceil(SECTOR_BYTES) + EMPTY_SECTORS) * SECTOR_BYTES);
        Self { network, files, records }
    }

    /// The entries that these records leave.
    fn entries(records: &[Placed]) -> Vec<Entry> {
        let mut entries: Vec<Entry> = Vec::new();
        for placed in records {
            if let Record::Entry(entry) = &placed.record {
                while entries.last().is_some_and(|before| before.index >= entry.index) {
                    entries.pop();
                }
                entries.push(entry.clone());
            }
        }
        entries
    }

    /// Opens the log with one file changed; what the store then has, entry by entry.
    fn open(&self, file: usize, content: Vec<u8>) -> Result<Vec<Entry>, StoreError> {
        let mut files = self.files.clone();
        files[file].1 = content;
        let mut salt = 0;
        let options = Options::new(self.network, move || {
            salt += 1;
            salt
        });
        let (store, recovery) = BlockStore::open(disk(&files), options)?;
        store.entries(recovery.first_index..recovery.last_index + 1, usize::MAX)
    }

    /// Opens the log, damaged from one byte of a file on to another; it must be what it has to be.
    fn judge(&self, file: usize, (from, to): (usize, usize), content: Vec<u8>, outcomes: &mut Outcomes) {
        let name = &self.files[file].0;
        let what = format!("{name} damaged from byte {from} to {to}");
        let damaged = |placed: &Placed| placed.file == file && placed.end > from && placed.start < to;
        let first = self.records.iter().position(damaged);
        let header = from < HEADER_BYTES as usize;
        let newest = file + 1 == self.files.len();
        // Is there something left that says that the damaged record had been durable?
        let vouched = first.is_some_and(|first| {
            let later = self.records[first + 1..].iter().filter(|placed| !damaged(placed));
            later.map(|placed| placed.durable_upto).max().is_some_and(|upto| upto > self.records[first].position)
        });
        match self.open(file, content) {
            Ok(entries) => {
                assert!(!header, "{what}: a damaged header was taken");
                assert!(!vouched && (newest || first.is_none()), "{what}: what had been durable was dropped");
                let intact = &self.records[..first.unwrap_or(self.records.len())];
                assert!(entries == Self::entries(intact), "{what}: other entries than those before the damage");
                outcomes.repaired += 1;
            }
            Err(StoreError::Corrupt { file: named, offset, .. }) => {
                assert!(header || vouched || !newest, "{what}: a torn tail was refused");
                let start = first.map_or(0, |first| self.records[first].start);
                let start = if header { 0 } else { start };
                assert!(named == *name && (start..=from).contains(&(offset as usize)), "{what}: {named} byte {offset}");
                outcomes.refused += 1;
            }
            Err(other) => panic!("{what}: {other}"),
        }
    }
}

fn disk(files: &[(String, Vec<u8>)]) -> Arc<dyn Disk> {
    let disk = SimDisk::new(1);
    for (name, content) in files {
        disk.set_contents(name, content);
    }
    Arc::new(disk)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_log_cut_at_any_byte_or_with_a_flipped_bit_in_any_sector_is_repaired_or_refused_and_never_wrong() {
    let mut dice = Dice::roll("damaged logs");
    let history = History::killed().await;
    let network = history.cluster.fleet.founded.network.0;
    let (mut cuts, mut flips) = (Outcomes::default(), Outcomes::default());
    // A voter; with more rounds, the others too.
    for place in history.cluster.fleet.nodes.iter().take(rounds() as usize) {
        let log = Log::read(network, &place.segments());
        assert!(log.files.len() > 1 && log.records.len() > 100, "too little history");
        let newest = log.files.len() - 1;
        let last = &log.records[log.records.len() - RECORDS_CUT..];
        for cut in last[0].start..last[RECORDS_CUT - 1].end {
            let end = log.files[newest].1.len();
            let mut zeroed = log.files[newest].1.clone();
            zeroed[cut..].fill(0);
            // Zeros that stay zeros are no damage.
            let same = zeroed == log.files[newest].1;
            log.judge(newest, (if same { end } else { cut }, end), zeroed, &mut cuts);
            log.judge(newest, (cut, end), log.files[newest].1[..cut].to_vec(), &mut cuts);
        }
        for file in 0..log.files.len() {
            let length = log.files[file].1.len();
            let used = log.records.iter().filter(|placed| placed.file == file).map(|placed| placed.end).max().unwrap();
            let used = used.div_ceil(SECTOR_BYTES);
            let step = if file == newest || rounds() > 1 { 1 } else { OLD_SECTORS_STEP };
            for sector in (0..(used + EMPTY_SECTORS).min(length / SECTOR_BYTES)).step_by(step) {
                let byte = sector * SECTOR_BYTES + dice.below(SECTOR_BYTES as u64) as usize;
                let mut flipped = log.files[file].1.clone();
                flipped[byte] ^= 1 << dice.below(8);
                log.judge(file, (byte, byte + 1), flipped, &mut flips);
            }
            // The headers: every byte of them.
            for byte in 0..HEADER_BYTES as usize {
                let mut flipped = log.files[file].1.clone();
                flipped[byte] ^= 1 << dice.below(8);
                log.judge(file, (byte, byte + 1), flipped, &mut flips);
            }
        }
    }
    println!(
        "faults injected: {} cuts of logs ({} repaired, {} refused), {} flipped bits in logs ({} repaired, {} refused)",
        cuts.repaired + cuts.refused,
        cuts.repaired,
        cuts.refused,
        flips.repaired + flips.refused,
        flips.repaired,
        flips.refused
    );
    assert!(cuts.repaired > 0 && flips.repaired > 0 && flips.refused > 0);
}
