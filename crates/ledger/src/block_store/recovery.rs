//! Opening a store: read everything, believe what is proven, repair a torn tail, refuse rot.

use std::sync::Arc;

use super::StoreError;
use super::ahead::write_zeros;
use super::index::{Location, LogIndex};
use super::recent::Recent;
use super::stored::StoredSegment;
use crate::disk::Disk;
use crate::entry::{Entry, HardState};
use crate::segment::{Found, HEADER_BYTES, Record, ScannedSegment, Tail, scan};

/// What opening a store found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Recovery {
    /// How many segments there are.
    pub segments: usize,
    /// The newest entry; 0 if there is none.
    pub last_index: u64,
    /// The newest hard state.
    pub hard_state: HardState,
    /// The torn tail that was zeroed. The caller should compare `last_index` with what it knows to be committed.
    pub torn: Option<TornTail>,
    /// Files in the directory that are none of the store's; left alone.
    pub ignored: Vec<String>,
}

/// A write that was cut off before it was acknowledged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TornTail {
    /// Name of the file.
    pub file: String,
    /// First byte zeroed.
    pub offset: u64,
    /// How many bytes were zeroed.
    pub bytes: u64,
}

/// Everything the store is rebuilt from.
pub(super) struct Recovered {
    pub(super) index: LogIndex,
    pub(super) recent: Recent,
    pub(super) segments: Vec<Arc<StoredSegment>>,
    /// End of the log in the newest segment, and length of that file.
    pub(super) tail: Tail,
    pub(super) length: u64,
    /// The index after the newest entry written, superseded or not.
    pub(super) next_index: u64,
    pub(super) report: Recovery,
}

pub(super) fn recover(disk: &dyn Disk, network: &[u8; 32], cache_bytes: usize) -> Result<Recovered, StoreError> {
    let mut scan = scan(disk, Some(network))?;
    let mut report = Recovery { segments: scan.segments().len(), ..Recovery::default() };
    let mut index = LogIndex::default();
    let mut recent = Recent::new(cache_bytes);
    let mut next_index = 1;
    for found in scan.by_ref() {
        match found? {
            Found::Record { file, position, bytes, record, .. } => {
                let refuse = |what: String, at| StoreError::corrupt(&file, position.offset.into(), what, at);
                match record {
                    Record::Entry(entry) => {
                        let at = entry.index;
                        next_index = at.saturating_add(1);
                        check_entry(&index, &entry, report.hard_state.commit).map_err(|what| refuse(what, at))?;
                        index.append(at, entry.term);
                        index.place(at, Location { sequence: position.sequence, offset: position.offset, bytes });
                        recent.append(entry);
                        recent.trim(at);
                    }
                    Record::HardState(state) => {
                        check_hard_state(&report.hard_state, &state, index.last())
                            .map_err(|what| refuse(what, index.last()))?;
                        report.hard_state = state;
                    }
                }
            }
            Found::Torn { file, offset, bytes, .. } => {
                report.torn = Some(TornTail { file: file.to_string(), offset, bytes });
            }
        }
    }
    report.last_index = index.last();
    let tail = scan.tail();
    let length = match scan.segments().last() {
        Some(newest) => settle(newest, tail, report.torn.as_ref())?,
        None => 0,
    };
    for name in scan.ignored() {
        // Unfinished segments were never part of the log.
        if name.strip_suffix(".new").is_some_and(|number| number.len() == 10 && number.parse::<u32>().is_ok()) {
            disk.remove(name).map_err(|error| StoreError::io("remove", name, error))?;
        } else {
            report.ignored.push(name.clone());
        }
    }
    disk.sync_dir().map_err(|error| StoreError::io("sync the directory", ".", error))?;
    let segments = scan.segments().iter().map(stored).collect();
    Ok(Recovered { index, recent, segments, tail, length, next_index, report })
}

/// Makes sure that what was read is on disk, and that zeros follow it; returns the length of the file.
///
/// What its own records do not prove durable is written again: it may be in the page cache only, and after a failed
/// sync the kernel takes such pages for clean, so a sync alone would not save them.
fn settle(newest: &ScannedSegment, tail: Tail, torn: Option<&TornTail>) -> Result<u64, StoreError> {
    const PIECE_BYTES: u64 = 1 << 20;
    let ScannedSegment { name, file, .. } = newest;
    let mut at = tail.proven.max(HEADER_BYTES);
    while at < tail.end {
        let mut piece = vec![0; usize::try_from(PIECE_BYTES.min(tail.end - at)).unwrap_or(0)];
        let count = file.read_at(&mut piece, at).map_err(|error| StoreError::io("read", name, error))?;
        if count < piece.len() {
            return Err(StoreError::corrupt(name, at, "the file became shorter while it was read", 0));
        }
        file.write_at(&piece, at).map_err(|error| StoreError::io("write", name, error))?;
        at += count as u64;
    }
    if let Some(torn) = torn {
        write_zeros(file.as_ref(), name, torn.offset, torn.offset + torn.bytes)?;
    }
    file.sync_data().map_err(|error| StoreError::io("sync", name, error))?;
    file.len().map_err(|error| StoreError::io("measure", name, error))
}

fn stored(segment: &ScannedSegment) -> Arc<StoredSegment> {
    Arc::new(StoredSegment {
        name: segment.name.to_string(),
        sequence: segment.header.sequence,
        salt: segment.header.salt,
        file: Arc::clone(&segment.file),
    })
}

/// Whether `entry` may follow: no gap, no falling term, nothing committed superseded.
pub(super) fn check_entry(index: &LogIndex, entry: &Entry, committed: u64) -> Result<(), String> {
    let Entry { index: at, term, .. } = *entry;
    if at == 0 || at > index.last() + 1 {
        return Err(format!("entry {at} follows entry {}", index.last()));
    }
    if at <= committed {
        return Err(format!("entry {at} would supersede what is committed, up to {committed}"));
    }
    match index.term(at - 1) {
        Some(before) if before > term => Err(format!("entry {at} has term {term}, the one before has {before}")),
        _ => Ok(()),
    }
}

/// Whether `new` may follow `old` when the log ends at `last`.
pub(super) fn check_hard_state(old: &HardState, new: &HardState, last: u64) -> Result<(), String> {
    if new.term < old.term {
        return Err(format!("hard state of term {} follows one of term {}", new.term, old.term));
    }
    if new.commit > last {
        return Err(format!("the hard state calls {} committed, the log ends at {last}", new.commit));
    }
    Ok(())
}
