//! How far the newest segment of a node, which may be writing to it, holds blocks that are committed for good.

use crate::block_store::StoreError;
use crate::disk::Disk;
use crate::entry::HardState;
use crate::segment::{Found, HEADER_BYTES, LogPosition, Record, Scan, ScannedSegment, encode_record};
use std::collections::VecDeque;

/// A record may be seen half written, beside one that follows it; how often to look again.
const ATTEMPTS_MAX: usize = 8;

/// The committed beginning of a segment.
pub(super) struct Committed {
    /// Height of the newest block that is committed.
    pub(super) height: u64,
    /// First byte after its record, or after the header if it is in an older segment.
    pub(super) end: u64,
    /// The hard state that says so, as a record for that place. The node wrote it further on, behind blocks that are
    /// not committed, or did not write it yet.
    pub(super) record: Vec<u8>,
}

/// The end of a record.
struct Spot {
    index: u64,
    end: u64,
    /// CRC of its header.
    previous: u32,
}

/// Reads the newest segment up to the last block that is committed. A hard state says so that is on the disk, as a
/// later record proves, or its height is `known` to be. Entries that are not proven may be replaced after a crash.
pub(super) fn committed(disk: &dyn Disk, segment: &ScannedSegment, known: u64) -> Result<Committed, StoreError> {
    let mut before = None;
    for _ in 0..ATTEMPTS_MAX {
        match read(disk, segment, known) {
            // What is wrong twice at the same place is not being written.
            Err(StoreError::Corrupt { offset, .. }) if before != Some(offset) => before = Some(offset),
            read => return read,
        }
    }
    read(disk, segment, known)
}

fn read(disk: &dyn Disk, segment: &ScannedSegment, known: u64) -> Result<Committed, StoreError> {
    let mut scan = Scan::unfinished(disk, &segment.name, segment);
    let (mut commit, mut hard_state) = (known, HardState::default());
    let mut last = Spot { index: segment.header.first_index - 1, end: HEADER_BYTES, previous: segment.crc };
    // Entries that are not known to be committed, and hard states that are not proven.
    let (mut entries, mut commits) = (VecDeque::<Spot>::new(), VecDeque::<(u64, u64)>::new());
    while let Some(found) = scan.next() {
        // The rest is being written.
        let Found::Record { position, record, .. } = found? else { break };
        let tail = scan.tail();
        match record {
            Record::Entry(entry) => {
                entries.retain(|before| before.index < entry.index);
                entries.push_back(Spot { index: entry.index, end: tail.end, previous: tail.previous });
            }
            Record::HardState(state) => {
                // What a segment begins with is on the disk before it has its name.
                let proven = if u64::from(position.offset) == HEADER_BYTES { 0 } else { tail.end };
                commits.push_back((proven, state.commit));
                hard_state = state;
            }
            Record::Seal(_) => {}
        }
        while let Some((_, proven)) = commits.pop_front_if(|(end, _)| *end <= tail.proven) {
            commit = commit.max(proven);
        }
        while let Some(spot) = entries.pop_front_if(|spot| spot.index <= commit) {
            last = spot;
        }
    }
    let tail = scan.tail();
    if commit > tail.newest.index {
        let what = format!("the log ends here with block {}, although block {commit} was committed", tail.newest.index);
        return Err(StoreError::corrupt(&segment.name, tail.end, what, tail.newest.index + 1));
    }
    let Spot { end, previous, .. } = last;
    let offset = u32::try_from(end).unwrap_or(u32::MAX);
    // All before it is on the disk: a later change of any byte is then told from a write that was cut off.
    let durable_upto = LogPosition { sequence: segment.header.sequence, offset };
    let (hard_state, mut record) = (HardState { commit, ..hard_state }, Vec::new());
    encode_record(&Record::HardState(hard_state), segment.header.salt, offset, previous, durable_upto, &mut record);
    Ok(Committed { height: commit, end, record })
}
