//! Segments that are cut or rotten, as the store finds them when it opens: thousands of copies of a real log.

use super::History;
use crate::rounds;
use crate::support::Dice;
use ledger_storage::block_store::{BlockStore, Options, StoreError};
use ledger_storage::disk::{Disk, SimDisk};
use ledger_storage::entry::Entry;
use ledger_storage::segment::{Found, HEADER_BYTES, LogPosition, Record, scan};
use std::path::PathBuf;
use std::sync::Arc;

/// Unit in which disks rot.
const SECTOR_BYTES: usize = 512;
/// Records at the end of the log that are cut at every byte.
const RECORDS_CUT: usize = 16;
/// Sectors behind the end of the log in which a bit is flipped.
const EMPTY_SECTORS: usize = 20;
/// Size of the segments into which the log is written again, so that it has several.
const SMALL_SEGMENT_BYTES: u64 = 16 * 1024;

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

/// The fate of a damaged log.
#[derive(Default)]
struct Outcomes {
    repaired: u64,
    refused: u64,
}

impl Outcomes {
    fn add(&mut self, other: &Self) {
        self.repaired += other.repaired;
        self.refused += other.refused;
    }

    fn told(&self) -> String {
        let Self { repaired, refused } = self;
        format!("{} ({repaired} repaired, {refused} refused)", repaired + refused)
    }
}

impl Log {
    /// The segments of a node.
    fn read(network: [u8; 32], segments: &[PathBuf]) -> Self {
        let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        Self::scan(network, segments.iter().map(|path| (name(path), std::fs::read(path).unwrap())).collect())
    }

    fn scan(network: [u8; 32], mut files: Vec<(String, Vec<u8>)>) -> Self {
        let mut records: Vec<Placed> = Vec::new();
        for found in scan(&disk(&files), Some(&network)).unwrap() {
            let Found::Record { file, position, bytes, durable_upto, record } = found.unwrap() else { continue };
            let (start, file) = (position.offset as usize, files.iter().position(|(name, _)| **name == *file).unwrap());
            records.push(Placed { file, start, end: start + bytes as usize, durable_upto, position, record });
        }
        // Most of the newest segment is zeros that were written ahead; a few sectors of them will do.
        let end = records.last().map_or(0, |last| last.end);
        files.last_mut().unwrap().1.truncate((end.div_ceil(SECTOR_BYTES) + EMPTY_SECTORS) * SECTOR_BYTES);
        Self { network, files, records }
    }

    /// The same entries and hard states, each flushed, in small segments.
    fn in_small_segments(&self) -> Self {
        let disk = SimDisk::new(1);
        let mut options = options(self.network);
        options.segment_bytes = SMALL_SEGMENT_BYTES;
        let (store, _) = BlockStore::open(Arc::new(disk.clone()), options).unwrap();
        for placed in &self.records {
            match &placed.record {
                Record::Entry(entry) => store.append(std::slice::from_ref(entry), None).unwrap(),
                Record::HardState(state) => store.append(&[], Some(state)).unwrap(),
                // The store writes its own.
                Record::Seal(_) => continue,
            }
            store.flush().unwrap();
            while store.prepare().unwrap() {}
        }
        drop(store);
        let names = disk.list().unwrap().into_iter().filter(|name| name.ends_with(".seg"));
        Self::scan(self.network, names.map(|name| (name.clone(), disk.contents(&name).unwrap())).collect())
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

    /// Opens the log with one file changed; the answer is the content of the store then, entry by entry. A reader, or the check that
    /// follows a start, finds the part that opening does not read.
    fn open(&self, file: usize, content: Vec<u8>) -> Result<Vec<Entry>, StoreError> {
        let mut files = self.files.clone();
        files[file].1 = content;
        let (store, recovery) = BlockStore::open(Arc::new(disk(&files)), options(self.network))?;
        let entries = store.entries(recovery.first_index..recovery.last_index + 1, usize::MAX)?;
        store.check_finished(|_| true).map(|()| entries)
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

fn disk(files: &[(String, Vec<u8>)]) -> SimDisk {
    let disk = SimDisk::new(1);
    for (name, content) in files {
        disk.set_contents(name, content);
    }
    disk
}

fn options(network: [u8; 32]) -> Options {
    let mut salt = 0;
    Options::new(network, move || {
        salt += 1;
        salt
    })
}

impl Log {
    /// Cuts the newest segment at every byte of its last records: what follows is zero, or not there.
    fn cut(&self) -> Outcomes {
        let mut outcomes = Outcomes::default();
        let newest = self.files.len() - 1;
        let content = &self.files[newest].1;
        let here: Vec<_> = self.records.iter().filter(|placed| placed.file == newest).collect();
        let first = here[here.len().saturating_sub(RECORDS_CUT)].start;
        for cut in first..here[here.len() - 1].end {
            let mut zeroed = content.clone();
            zeroed[cut..].fill(0);
            // Zeros that stay zeros are no damage: a record that ends in some is whole when only they are cut.
            let from = content[cut..].iter().position(|&byte| byte != 0).map_or(content.len(), |zeros| cut + zeros);
            self.judge(newest, (from, content.len()), zeroed, &mut outcomes);
            self.judge(newest, (cut, content.len()), content[..cut].to_vec(), &mut outcomes);
        }
        outcomes
    }

    /// Flips a bit in every sector of every segment, and in every byte of their headers.
    fn flip(&self, dice: &mut Dice) -> Outcomes {
        let mut outcomes = Outcomes::default();
        for (file, (_, content)) in self.files.iter().enumerate() {
            let sectors = (0..content.len()).step_by(SECTOR_BYTES);
            let in_sectors = sectors.map(|start| (start, SECTOR_BYTES.min(content.len() - start) as u64));
            for (start, bytes) in in_sectors.chain((0..HEADER_BYTES as usize).map(|byte| (byte, 1))) {
                let byte = start + dice.below(bytes) as usize;
                let mut flipped = content.clone();
                flipped[byte] ^= 1 << dice.below(8);
                self.judge(file, (byte, byte + 1), flipped, &mut outcomes);
            }
        }
        outcomes
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_log_cut_at_any_byte_or_with_a_flipped_bit_in_any_sector_is_repaired_or_refused_and_never_wrong() {
    let mut dice = Dice::roll("damaged logs");
    let history = History::killed(0).await;
    let network = history.cluster.fleet.founded.network.0;
    let (mut cuts, mut flips) = (Outcomes::default(), Outcomes::default());
    // A voter; with more rounds, the others too.
    for place in history.cluster.fleet.nodes.iter().take(rounds() as usize) {
        let log = Log::read(network, &place.segments());
        let split = log.in_small_segments();
        assert!(split.files.len() > 2 && split.records.len() > 100, "too little history");
        cuts.add(&log.cut());
        cuts.add(&split.cut());
        flips.add(&log.flip(&mut dice));
        flips.add(&split.flip(&mut dice));
    }
    println!("faults injected: {} by cutting logs, {} by flipping bits in logs", cuts.told(), flips.told());
    assert!(cuts.repaired > 0 && flips.repaired > 0 && flips.refused > 0);
}
