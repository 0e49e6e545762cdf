//! Which segment is the oldest one, as the store has decided it: so that one that somebody has deleted is missed.
//!
//! File `oldest` beside the segments: two slots, one at byte 0 and one at byte 4096. The valid one with the higher
//! sequence counts. The other one is written next, in place, so that no space is needed on a full disk and a write that
//! is cut off harms nothing. Little-endian:
//!
//! | bytes | field |
//! |---|---|
//! | 8 | `ledgold1` |
//! | 4 | sequence of the oldest segment |
//! | 8 | its first index |
//! | 4 | CRC-32C of the bytes before |
//!
//! It is written before older segments are removed: after a crash there may be older ones than it says, never newer
//! ones only. A log that begins anew (after a snapshot) says so in its first segment, and needs no word of this file.

use std::io::{self, ErrorKind};
use std::sync::Arc;

use super::StoreError;
use crate::disk::{Disk, DiskFile};
use crate::segment::Scan;

/// Name of the file.
pub(super) const FILE: &str = "oldest";
/// Its name while it is made.
pub(super) const PART_FILE: &str = "oldest.part";
/// The beginning of a slot.
const MAGIC: &[u8; 8] = b"ledgold1";
/// Bytes of a slot.
const SLOT_BYTES: usize = 24;
/// Where the slots begin: in two blocks of any disk.
const SLOTS: [u64; 2] = [0, 4096];

/// The segment with which the log begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Beginning {
    pub(super) sequence: u32,
    pub(super) first_index: u64,
}

/// The file. Used by one at a time.
pub(super) struct Oldest {
    disk: Arc<dyn Disk>,
    noted: Option<Beginning>,
    /// The slot that holds it.
    slot: usize,
    /// It is on the disk for sure. A process that ended between a write and its sync leaves it in the page cache alone.
    durable: bool,
}

impl Oldest {
    /// Reads the file, if there is one.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if no slot of it can be read.
    pub(super) fn read(disk: Arc<dyn Disk>) -> Result<Self, StoreError> {
        let (noted, slot) = read(disk.as_ref())?.map_or((None, 1), |(place, slot)| (Some(place), slot));
        Ok(Self { disk, noted, slot, durable: false })
    }

    /// Notes that the log begins with this segment from now on.
    pub(super) fn note(&mut self, place: Beginning) -> Result<(), StoreError> {
        if let Some(noted) = self.noted.filter(|_| !self.durable) {
            // Where it stands: the other slot is all that a crash in the middle of this leaves for sure.
            self.write(noted, self.slot)?;
        }
        if self.noted.is_none_or(|noted| noted.sequence < place.sequence) {
            self.write(place, 1 - self.slot)?;
        }
        Ok(())
    }

    fn write(&mut self, place: Beginning, slot: usize) -> Result<(), StoreError> {
        let offset = SLOTS.get(slot).copied().unwrap_or_default();
        let write = |file: &Arc<dyn DiskFile>| file.write_at(&encode(place), offset).and_then(|()| file.sync_data());
        let written = match self.disk.open(FILE) {
            Err(error) if error.kind() == ErrorKind::NotFound => self.create(&write),
            file => file.and_then(|file| write(&file)),
        };
        written.map_err(|error| StoreError::writing("write", FILE, SLOT_BYTES as u64, error))?;
        (self.noted, self.slot, self.durable) = (Some(place), slot, true);
        Ok(())
    }

    /// Makes the file as a whole, with room for both slots.
    fn create(&self, write: &dyn Fn(&Arc<dyn DiskFile>) -> io::Result<()>) -> io::Result<()> {
        let file = self.disk.create(PART_FILE)?;
        for offset in SLOTS {
            file.write_at(&[0; SLOT_BYTES], offset)?;
        }
        write(&file)?;
        self.disk.rename(PART_FILE, FILE)?;
        self.disk.sync_dir()
    }
}

/// Refuses a log whose oldest segments are missing. Only this file knows of them; a store from before it had one is
/// believed.
///
/// # Errors
/// [`StoreError::Corrupt`] with the first index that is missing.
pub fn check_oldest(disk: &dyn Disk, scan: &Scan<'_>) -> Result<(), StoreError> {
    let Some((noted, _)) = read(disk)? else { return Ok(()) };
    let found = scan.segments().first().map(|oldest| (oldest.header.begins_log(), oldest.header.sequence));
    let what = match found {
        Some((begins_log, sequence)) if begins_log || sequence <= noted.sequence => return Ok(()),
        // The first segment may not have been written before a crash.
        None if noted.sequence <= 1 => return Ok(()),
        Some((_, sequence)) => format!("segments {} to {} are missing", noted.sequence, sequence.saturating_sub(1)),
        None => format!("segment {} and all after it are missing", noted.sequence),
    };
    let what = format!("{what}: this node did not drop them, so their files were deleted");
    Err(StoreError::corrupt(FILE, 0, what, noted.first_index))
}

/// The valid slot with the higher sequence; none if there is no file.
fn read(disk: &dyn Disk) -> Result<Option<(Beginning, usize)>, StoreError> {
    let file = match disk.open(FILE) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        file => file.map_err(|error| StoreError::io("open", FILE, error))?,
    };
    let mut found = None;
    for (slot, offset) in SLOTS.into_iter().enumerate() {
        let mut bytes = [0; SLOT_BYTES];
        let count = file.read_at(&mut bytes, offset).map_err(|error| StoreError::io("read", FILE, error))?;
        let place = decode(bytes.get(..count).unwrap_or_default());
        found = found.max(place.map(|place| (place.sequence, place.first_index, slot)));
    }
    match found {
        Some((sequence, first_index, slot)) => Ok(Some((Beginning { sequence, first_index }, slot))),
        None => Err(StoreError::corrupt(FILE, 0, "neither of its slots can be read", 0)),
    }
}

fn encode(place: Beginning) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(place.sequence.to_le_bytes());
    bytes.extend(place.first_index.to_le_bytes());
    bytes.extend(crc32c::crc32c(&bytes).to_le_bytes());
    bytes
}

fn decode(bytes: &[u8]) -> Option<Beginning> {
    let (body, crc) = bytes.split_last_chunk::<4>()?;
    if bytes.len() != SLOT_BYTES || crc32c::crc32c(body).to_le_bytes() != *crc {
        return None;
    }
    let (sequence, first_index) = body.strip_prefix(MAGIC)?.split_first_chunk::<4>()?;
    let first_index = first_index.first_chunk::<8>()?;
    Some(Beginning { sequence: u32::from_le_bytes(*sequence), first_index: u64::from_le_bytes(*first_index) })
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::disk::{RealDisk, SimDisk};

    fn place(sequence: u32) -> Beginning {
        Beginning { sequence, first_index: u64::from(sequence) * 100 }
    }

    #[test]
    fn the_newest_of_two_slots_counts_and_a_torn_write_leaves_the_other() {
        let directory = tempfile::tempdir().unwrap();
        let disk: Arc<dyn Disk> = Arc::new(RealDisk::open(directory.path()).unwrap());
        assert_eq!(read(disk.as_ref()).unwrap(), None);
        let mut oldest = Oldest::read(Arc::clone(&disk)).unwrap();
        for sequence in [1, 2, 5, 3] {
            oldest.note(place(sequence)).unwrap();
        }
        assert_eq!(read(disk.as_ref()).unwrap().unwrap(), (place(5), 0), "it never goes back");
        let mut again = Oldest::read(Arc::clone(&disk)).unwrap();
        again.note(place(6)).unwrap();
        assert_eq!(read(disk.as_ref()).unwrap().unwrap(), (place(6), 1));
        let file = disk.open(FILE).unwrap();
        file.write_at(&[0xff], 4096 + 9).unwrap();
        assert_eq!(read(disk.as_ref()).unwrap().unwrap(), (place(5), 0));
        file.write_at(&[0xff], 9).unwrap();
        assert!(matches!(read(disk.as_ref()), Err(StoreError::Corrupt { .. })));
    }

    #[test]
    fn what_a_killed_process_has_written_and_not_synced_is_made_durable_before_older_segments_go() {
        for seed in 0..64 {
            let disk = SimDisk::new(seed);
            let shared: Arc<dyn Disk> = Arc::new(disk.clone());
            let mut oldest = Oldest::read(Arc::clone(&shared)).unwrap();
            [1, 2].into_iter().for_each(|sequence| oldest.note(place(sequence)).unwrap());
            disk.fail_sync(1);
            oldest.note(place(3)).unwrap_err();
            disk.kill();
            let mut again = Oldest::read(Arc::clone(&shared)).unwrap();
            assert_eq!(again.noted, Some(place(3)), "it stands in the page cache");
            again.note(place(3)).unwrap();
            disk.crash();
            assert_eq!(read(&disk).unwrap().unwrap().0, place(3), "seed {seed}");
        }
    }

    #[test]
    fn a_crash_in_the_middle_leaves_the_place_before_or_after_whatever_a_killed_process_left() {
        for (seed, next) in (0..64).flat_map(|seed| [(seed, 3), (seed, 4)]) {
            let disk = SimDisk::new(seed);
            let shared: Arc<dyn Disk> = Arc::new(disk.clone());
            let mut oldest = Oldest::read(Arc::clone(&shared)).unwrap();
            [1, 2].into_iter().for_each(|sequence| oldest.note(place(sequence)).unwrap());
            disk.fail_sync(1);
            oldest.note(place(3)).unwrap_err();
            disk.kill();
            let mut again = Oldest::read(Arc::clone(&shared)).unwrap();
            disk.fail_sync(1 + seed % 2);
            let _cut_off = again.note(place(next));
            disk.crash();
            let found = read(&disk).unwrap().unwrap().0;
            assert!(found.sequence >= 2, "seed {seed}: {found:?}, but the first segment is gone");
        }
    }
}
