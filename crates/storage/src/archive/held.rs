//! The newest segment of an archive, which may not have been finished when it was copied.

use super::copy::{Wanted, whole};
use super::fault::{in_archive, in_node};
use crate::block_store::StoreError;
use crate::disk::{Disk, DiskFile};
use crate::segment::{Found, Record, Scan, ScannedSegment};
use ledger_base::rejection::{Code, Rejection};
use std::io::{self, ErrorKind};

/// How much is compared at once.
const PIECE_BYTES: u64 = 1 << 20;

/// The content of the newest segment of an archive.
pub(super) struct Held {
    pub(super) segment: ScannedSegment,
    /// The height up to which it calls blocks committed.
    pub(super) commit: u64,
    /// Bytes that the node must have too: all but a hard state at the end, which the archive may have instead of blocks
    /// that were not committed.
    settled: u64,
    /// Bytes of its file.
    length: u64,
}

/// The same segment at the node.
pub(super) enum Comparison {
    /// Nothing else.
    Same,
    /// More, after the same blocks.
    Continues,
    /// It has dropped it meanwhile.
    Gone,
}

impl Held {
    /// Reads every record of it.
    pub(super) fn read(target: &dyn Disk, segment: &ScannedSegment) -> Result<Self, StoreError> {
        let mut scan = Scan::unfinished(target, &segment.name, segment);
        let (mut commit, mut settled) = (0, 0);
        while let Some(found) = scan.next() {
            let found = found?;
            settled = scan.tail().end;
            if let Found::Record { position, record: Record::HardState(state), .. } = &found {
                commit = commit.max(state.commit);
                settled = position.offset.into();
            }
            whole(found)?;
        }
        Ok(Self { segment: segment.clone(), commit, settled, length: scan.tail().end })
    }

    /// Refuses a node that has other blocks than the archive.
    pub(super) fn compare(
        &self,
        source: &dyn Disk,
        target: &dyn Disk,
        wanted: &Wanted<'_>,
    ) -> Result<Comparison, Rejection> {
        let name = &self.segment.name;
        let node = match source.open(name) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Comparison::Gone),
            file => file.map_err(|error| in_node(&StoreError::io("open", name, error)))?,
        };
        let archived = target.open(name).map_err(|error| in_archive(&StoreError::io("open", name, error)))?;
        let compared = first_difference(&*node, &*archived, self.length.min(wanted.end));
        let difference = compared.map_err(|error| in_node(&StoreError::io("compare", name, error)))?;
        if let Some(at) = difference.or(Some(wanted.end)).filter(|at| *at < self.settled) {
            return Err(Rejection::new(Code::ChainInvalid, "the archive and the node hold different blocks")
                .found(format!(
                    "{name}: they differ from byte {at} on, and the archive calls {} committed",
                    self.commit
                ))
                .wanted("a node whose blocks continue the archive")
                .next(
                    "keep both; run `ledgerd verify` on the archive, and on the node's directory while it is stopped",
                ));
        }
        let same = match wanted.next {
            Some(_) => difference.is_none() && self.length == wanted.end,
            None => self.settled == wanted.end && self.length == wanted.bytes(),
        };
        Ok(if same { Comparison::Same } else { Comparison::Continues })
    }
}

/// The first byte before `end` in which two files differ.
fn first_difference(one: &dyn DiskFile, other: &dyn DiskFile, end: u64) -> io::Result<Option<u64>> {
    let mut at = 0;
    while at < end {
        let count = usize::try_from(PIECE_BYTES.min(end - at)).unwrap_or(0);
        let (mut left, mut right) = (vec![0; count], vec![0; count]);
        let read = one.read_at(&mut left, at)?.min(other.read_at(&mut right, at)?);
        if let Some(found) = left.iter().zip(&right).take(read).position(|(left, right)| left != right) {
            return Ok(Some(at + found as u64));
        }
        if read < count {
            return Ok(Some(at + read as u64));
        }
        at += count as u64;
    }
    Ok(None)
}
