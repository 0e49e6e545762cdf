//! Opening a store: read what a crash may have damaged, believe what is proven, repair a torn tail, refuse rot.

use std::collections::VecDeque;
use std::sync::Arc;

use super::StoreError;
use super::ahead::write_zeros;
use super::files::StoredSegment;
use super::index::LogIndex;
use super::oldest;
use super::recent::Recent;
use super::writer::Active;
use crate::disk::{Disk, DiskFile};
use crate::entry::HardState;
use crate::segment::{Base, Contents, Found, HEADER_BYTES, Record, Scan, ScannedSegment, Seal, Tail, read_head, scan};

/// The findings of opening a store.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Recovery {
    /// How many segments there are.
    pub segments: usize,
    /// The oldest entry. Above 1 if older ones were dropped, or if somebody has removed their files.
    pub first_index: u64,
    /// The newest entry; one below `first_index` if there is none.
    pub last_index: u64,
    /// The newest hard state; entries that are older than the log count as committed.
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
    pub(super) segments: VecDeque<Arc<StoredSegment>>,
    /// The newest segment and the length of its file.
    pub(super) active: Option<Active>,
    pub(super) length: u64,
    /// End of the log in it.
    pub(super) tail: Tail,
    /// The content of the newest segment.
    pub(super) contents: Contents,
    /// The newest hard state as written.
    pub(super) written: HardState,
    pub(super) report: Recovery,
}

/// The knowledge after some of the segments.
struct Reading {
    index: LogIndex,
    recent: Recent,
    hard_state: HardState,
    torn: Option<TornTail>,
}

/// Reads the newest segment whole. Those before it were durable as a whole when it was begun, and it, or the one after
/// each of them, says what they hold. Their records are read, and checked, when somebody wants them
/// ([`BlockStore::entries`](super::BlockStore::entries),
/// [`BlockStore::check_finished`](super::BlockStore::check_finished)).
pub(super) fn recover(disk: &dyn Disk, network: &[u8; 32], cache_bytes: usize) -> Result<Recovered, StoreError> {
    let scan = scan(disk, Some(network))?;
    oldest::check_oldest(disk, &scan)?;
    let base = scan.base();
    let mut report = Recovery { segments: scan.segments().len(), first_index: base.index + 1, ..Recovery::default() };
    let mut reading = Reading {
        index: LogIndex::new(base),
        recent: Recent::new(cache_bytes),
        hard_state: HardState::default(),
        torn: None,
    };
    let pairs = scan.segments().iter().zip(scan.segments().iter().skip(1));
    for (number, (segment, next)) in pairs.enumerate() {
        let head = read_head(disk, next)?;
        match head.seal.filter(|seal| is_about(seal, segment, next)) {
            Some(seal) => reading.adopt(disk, segment, next, &seal.contents)?,
            None => scan.only(number).try_for_each(|found| reading.take(found?))?,
        }
        if let Some(hard_state) = head.hard_state {
            reading.hard_state(&next.name, HEADER_BYTES, hard_state)?;
        }
    }
    let mut newest = scan.only(scan.segments().len().saturating_sub(1));
    newest.by_ref().try_for_each(|found| reading.take(found?))?;
    let (tail, contents) = (newest.tail(), newest.into_contents());
    let Reading { index, mut recent, hard_state, torn } = reading;
    (report.hard_state, report.torn) = (hard_state, torn);
    recent.drop_before(report.first_index);
    report.last_index = index.last();
    let mut length = 0;
    let mut active = None;
    if let Some(newest) = scan.segments().last() {
        if index.last() < base.index {
            let what = format!("the log was cut at {}, but ends before", report.first_index);
            return Err(StoreError::corrupt(&newest.name, tail.end, what, index.last() + 1));
        }
        let file = disk.open(&newest.name).map_err(|error| StoreError::io("open", &newest.name, error))?;
        length = settle(&newest.name, file.as_ref(), tail, report.torn.as_ref())?;
        active = Some(Active { segment: stored(newest), file });
    }
    tidy(disk, &scan, &mut report)?;
    let written = report.hard_state;
    // What was dropped had been committed, even if nobody got to write that down.
    report.hard_state.commit = report.hard_state.commit.max(base.index);
    let segments = scan.segments().iter().map(stored).collect();
    Ok(Recovered { index, recent, segments, active, length, tail, contents, written, report })
}

/// Does the seal in `next` speak of this segment, and fit what the header beside it says?
fn is_about(seal: &Seal, segment: &ScannedSegment, next: &ScannedSegment) -> bool {
    let Seal { segment_crc, contents } = seal;
    let newest = match contents.last_term() {
        Some(term) => Base { index: contents.last, term },
        None => segment.header.base(),
    };
    let end = next.header.durable_upto.offset;
    *segment_crc == segment.crc
        && next.header.base() == newest
        && contents.marks.last().is_none_or(|(_, offset)| *offset < end)
}

impl Reading {
    /// Takes over a finished segment without reading its records.
    fn adopt(
        &mut self,
        disk: &dyn Disk,
        segment: &ScannedSegment,
        next: &ScannedSegment,
        contents: &Contents,
    ) -> Result<(), StoreError> {
        let name = &segment.name;
        let file = disk.open(name).map_err(|error| StoreError::io("open", name, error))?;
        let length = file.len().map_err(|error| StoreError::io("measure", name, error))?;
        let end = u64::from(next.header.durable_upto.offset);
        if length < end {
            let what = format!(
                "the file ends here, although a later segment proves that {end} bytes of it were \
                                durable"
            );
            return Err(StoreError::corrupt(name, length, what, segment.header.first_index));
        }
        if let Some((first, term)) = contents.first() {
            check_entry(&self.index, first, term, self.hard_state.commit)
                .map_err(|what| StoreError::corrupt(name, HEADER_BYTES, what, first))?;
        }
        // It holds what is newest, without a gap.
        self.recent.clear();
        self.index.adopt(segment.header.sequence, contents);
        Ok(())
    }

    fn take(&mut self, found: Found) -> Result<(), StoreError> {
        match found {
            Found::Record { file, position, record, .. } => match record {
                Record::Entry(entry) => {
                    let at = entry.index;
                    check_entry(&self.index, at, entry.term, self.hard_state.commit)
                        .map_err(|what| StoreError::corrupt(&file, position.offset.into(), what, at))?;
                    self.index.append(at, entry.term);
                    self.index.place(at, position);
                    self.recent.append(entry);
                    self.recent.trim(at);
                }
                Record::HardState(state) => self.hard_state(&file, position.offset.into(), state)?,
                Record::Seal(_) => {}
            },
            Found::Torn { file, offset, bytes, .. } => {
                self.torn = Some(TornTail { file: file.to_string(), offset, bytes });
            }
        }
        Ok(())
    }

    fn hard_state(&mut self, file: &str, offset: u64, state: HardState) -> Result<(), StoreError> {
        check_hard_state(&self.hard_state, &state, self.index.last())
            .map_err(|what| StoreError::corrupt(file, offset, what, self.index.last()))?;
        self.hard_state = state;
        Ok(())
    }
}

/// Removes what an interrupted change of files has left behind, and names what is not ours.
fn tidy(disk: &dyn Disk, scan: &Scan<'_>, report: &mut Recovery) -> Result<(), StoreError> {
    let remove = |name: &String| disk.remove(name).map_err(|error| StoreError::io("remove", name, error));
    // The segment that made these void must have its name for good before they go.
    let sync = || disk.sync_dir().map_err(|error| StoreError::io("sync the directory", ".", error));
    if !scan.void().is_empty() {
        sync()?;
        scan.void().iter().try_for_each(remove)?;
    }
    for name in scan.ignored().iter().filter(|name| *name != oldest::FILE) {
        // Unfinished segments were never part of the log.
        if name == oldest::PART_FILE
            || name.strip_suffix(".new").is_some_and(|number| number.len() == 10 && number.parse::<u32>().is_ok())
        {
            remove(name)?;
        } else {
            report.ignored.push(name.clone());
        }
    }
    sync()
}

/// Makes sure that what was read is on disk, and that zeros follow it; returns the length of the file.
///
/// Records that the log does not prove durable are written again. They may be in the page cache only, and after a
/// failed sync the kernel takes such pages for clean, so a sync alone would not save them.
fn settle(name: &str, file: &dyn DiskFile, tail: Tail, torn: Option<&TornTail>) -> Result<u64, StoreError> {
    const PIECE_BYTES: u64 = 1 << 20;
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
        write_zeros(file, name, torn.offset, torn.offset + torn.bytes)?;
    }
    file.sync_data().map_err(|error| StoreError::io("sync", name, error))?;
    file.len().map_err(|error| StoreError::io("measure", name, error))
}

fn stored(segment: &ScannedSegment) -> Arc<StoredSegment> {
    Arc::new(StoredSegment {
        name: segment.name.to_string(),
        sequence: segment.header.sequence,
        crc: segment.crc,
        salt: segment.header.salt,
        first_index: segment.header.first_index,
        bytes_before: segment.header.durable_upto.offset,
    })
}

/// Whether entry `at` may follow: no gap, no falling term, nothing committed superseded.
pub(super) fn check_entry(index: &LogIndex, at: u64, term: u64, committed: u64) -> Result<(), String> {
    if at == 0 || at > index.last() + 1 {
        return Err(format!("entry {at} follows entry {}", index.last()));
    }
    if at <= committed {
        return Err(format!("entry {at} would replace committed entries, up to {committed}"));
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
        return Err(format!("the hard state marks {} as committed, but the log ends at {last}", new.commit));
    }
    Ok(())
}
