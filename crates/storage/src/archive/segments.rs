//! Which segments an archive lacks, and whether they continue what it has.

use super::Reached;
use super::committed::{Committed, committed};
use super::copy::{Wanted, copy};
use super::fault::{in_archive, in_node, is_gone};
use super::held::{Comparison, Held};
use crate::block_store::{StoreError, check_oldest};
use crate::disk::Disk;
use crate::segment::{ScannedSegment, check_sealed, parse_name, scan};
use ledger_base::rejection::{Code, Rejection};

/// A node may drop segments while they are copied; how often to look again.
const ATTEMPTS_MAX: usize = 8;

/// The content of the archive, and the new part of it.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Copied {
    pub(super) first_height: u64,
    pub(super) next_height: u64,
    pub(super) segments: u64,
    pub(super) bytes: u64,
}

/// How far blocks are copied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Upto {
    /// To the end of the newest finished segment.
    Finished,
    /// To the newest block that is known to be committed: because the log says so, or up to this height because the
    /// node has executed it. That was read before the log is.
    Committed(u64),
}

/// Those who are called on the way.
pub(super) struct Watching<'a> {
    /// With the first height of the archive, before anything is copied.
    pub(super) begin: &'a mut dyn FnMut(u64) -> Result<(), Rejection>,
    /// After each segment.
    pub(super) tell: &'a mut dyn FnMut(Reached),
}

/// Copies from the block store `source`, which may be in use, to `target` all that it lacks.
pub(super) fn copy_segments(
    (source, target): (&dyn Disk, &dyn Disk),
    network: &[u8; 32],
    upto: Upto,
    mut watching: Watching<'_>,
) -> Result<Copied, Rejection> {
    remove_parts(target)?;
    let mut copied = Copied::default();
    for _ in 0..ATTEMPTS_MAX {
        if copy_once((source, target), network, upto, &mut watching, &mut copied)? {
            return Ok(copied);
        }
    }
    Err(Rejection::new(Code::BadFile, "the node drops blocks faster than they can be archived")
        .next("archive to a faster disk, or set a longer retention of the node"))
}

/// One pass over the segments; false if one was dropped meanwhile.
fn copy_once(
    (source, target): (&dyn Disk, &dyn Disk),
    network: &[u8; 32],
    upto: Upto,
    watching: &mut Watching<'_>,
    copied: &mut Copied,
) -> Result<bool, Rejection> {
    let from = match scan(source, Some(network)) {
        Err(error) if is_gone(&error) => return Ok(false),
        scan => scan.map_err(|error| in_node(&error))?,
    };
    check_oldest(source, &from).map_err(|error| in_node(&error))?;
    let there = scan(target, Some(network)).map_err(|error| in_archive(&error))?;
    let newest = there.segments().last();
    let held = newest.map(|newest| Held::read(target, newest)).transpose().map_err(|error| in_archive(&error))?;
    if let Some(held) = &held {
        check_continues(target, there.segments(), held, from.segments())?;
    }
    let Some(oldest) = there.segments().first().or(from.segments().first()) else {
        copied.next_height = 1;
        copied.first_height = 1;
        return Ok(true);
    };
    copied.first_height = oldest.header.first_index;
    (watching.begin)(copied.first_height)?;
    let archived = newest.map_or(0, |newest| newest.header.sequence);
    copied.next_height = newest.unwrap_or(oldest).header.first_index;
    for (number, segment) in from.segments().iter().enumerate() {
        if segment.header.sequence < archived {
            continue;
        }
        copied.next_height = segment.header.first_index;
        let wanted = match (from.segments().get(number + 1), upto) {
            (Some(next), _) => Wanted::finished(segment, next),
            (None, Upto::Finished) => break,
            (None, Upto::Committed(executed)) => {
                let known = executed.max(from.base().index).max(held.as_ref().map_or(0, |held| held.commit));
                match committed(source, segment, known) {
                    Err(error) if is_gone(&error) => return Ok(false),
                    read => {
                        let Committed { height, end, record } = read.map_err(|error| in_node(&error))?;
                        Wanted { segment, end, record, next: None, next_height: height + 1 }
                    }
                }
            }
        };
        let compared = match held.as_ref().filter(|_| segment.header.sequence == archived) {
            Some(held) => held.compare(source, target, &wanted)?,
            None => Comparison::Continues,
        };
        match compared {
            Comparison::Gone => return Ok(false),
            Comparison::Same => {}
            Comparison::Continues => {
                let Some(bytes) = copy(source, target, &wanted)? else { return Ok(false) };
                copied.segments += 1;
                copied.bytes += bytes;
            }
        }
        copied.next_height = wanted.next_height;
        (watching.tell)(Reached {
            segments: number as u64 + 1,
            of_segments: from.segments().len() as u64,
            bytes: copied.bytes,
        });
    }
    Ok(true)
}

/// Is what the node has of one piece with what is archived?
fn check_continues(
    target: &dyn Disk,
    archived: &[ScannedSegment],
    held: &Held,
    node: &[ScannedSegment],
) -> Result<(), Rejection> {
    let newest = &held.segment;
    let refuse = |what: &str, found: String| {
        Rejection::new(Code::BadFile, what).found(found).next("archive to a new directory; keep this one")
    };
    let mut common = false;
    for segment in archived {
        let Some(same) = node.iter().find(|other| other.header.sequence == segment.header.sequence) else { continue };
        if same.header != segment.header {
            let found = format!("{} here, {} in the archive: different salts or indexes", same.name, segment.name);
            return Err(refuse("the archive contains segments of another node", found));
        }
        common = true;
    }
    let Some(first) = node.first().filter(|_| !common) else { return Ok(()) };
    let follows = !first.header.begins_log() && first.header.sequence == newest.header.sequence + 1;
    let sealed = if follows { check_sealed(target, &newest.name, newest, first).map(|()| true) } else { Ok(false) };
    let sealed = match sealed {
        // Its records have been read and are good: it was not finished when it was archived, and its end is gone.
        Err(StoreError::Corrupt { .. }) => false,
        sealed => sealed.map_err(|error| in_archive(&error))?,
    };
    if !sealed {
        let found = format!(
            "an archive up to segment {}, and a node whose first segment is {}, block {}",
            newest.header.sequence, first.header.sequence, first.header.first_index
        );
        return Err(refuse("blocks between the archive and the node's oldest block are missing", found));
    }
    Ok(())
}

/// Removes what an interrupted run has left behind.
fn remove_parts(target: &dyn Disk) -> Result<(), Rejection> {
    let failed = |operation, name: &str, error| in_archive(&StoreError::io(operation, name, error));
    let names = target.list().map_err(|error| failed("list", ".", error))?;
    for name in names.iter().filter(|name| name.strip_suffix(".part").is_some_and(|name| parse_name(name).is_some())) {
        target.remove(name).map_err(|error| failed("remove", name, error))?;
    }
    Ok(())
}
