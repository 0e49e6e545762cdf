//! Copying finished segments: each is checked record by record in its new place before it gets its name there.

use crate::block_store::StoreError;
use crate::code::Code;
use crate::disk::Disk;
use crate::rejection::Rejection;
use crate::segment::{ScannedSegment, check_sealed, parse_name, scan};
use std::io::{self, ErrorKind};

/// How much is copied at once.
const PIECE_BYTES: u64 = 1 << 20;

/// A node may drop segments while they are copied; how often to look again.
const ATTEMPTS_MAX: usize = 8;

/// What the archive holds, and what of it is new.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Copied {
    pub(super) first_height: u64,
    pub(super) next_height: u64,
    pub(super) segments: u64,
    pub(super) bytes: u64,
}

/// Copies from the block store `source`, which may be in use, to `target` all finished segments that it lacks. `begin` is
/// called with the first height of the archive before anything is copied.
pub(super) fn copy_segments(
    source: &dyn Disk,
    target: &dyn Disk,
    network: &[u8; 32],
    mut begin: impl FnMut(u64) -> Result<(), Rejection>,
) -> Result<Copied, Rejection> {
    remove_parts(target).map_err(|error| in_archive(&error))?;
    let mut copied = Copied::default();
    for _ in 0..ATTEMPTS_MAX {
        if copy_once(source, target, network, &mut begin, &mut copied)? {
            return Ok(copied);
        }
    }
    Err(Rejection::new(Code::BadFile, "the node drops blocks faster than they can be archived")
        .next("archive to a faster disk, or let the node keep blocks for longer"))
}

/// One pass over the segments; false if one was dropped meanwhile.
fn copy_once(
    source: &dyn Disk,
    target: &dyn Disk,
    network: &[u8; 32],
    begin: &mut impl FnMut(u64) -> Result<(), Rejection>,
    copied: &mut Copied,
) -> Result<bool, Rejection> {
    let from = match scan(source, Some(network)) {
        Err(error) if is_gone(&error) => return Ok(false),
        scan => scan.map_err(|error| in_node(&error))?,
    };
    let there = scan(target, Some(network)).map_err(|error| in_archive(&error))?;
    let newest = there.segments().last();
    if let Some(newest) = newest {
        check_continues(target, there.segments(), newest, from.segments())?;
    }
    let Some(oldest) = there.segments().first().or(from.segments().first()) else {
        copied.next_height = 1;
        copied.first_height = 1;
        return Ok(true);
    };
    copied.first_height = oldest.header.first_index;
    begin(copied.first_height)?;
    let archived = newest.map_or(0, |newest| newest.header.sequence);
    let (mut next_height, mut before) = (newest.unwrap_or(oldest).header.first_index, None);
    for segment in from.segments().iter().filter(|segment| segment.header.sequence >= archived) {
        if let Some(before) = before.replace(segment).filter(|before| before.header.sequence > archived) {
            let Some(bytes) = copy(source, target, before, segment)? else { return Ok(false) };
            copied.segments += 1;
            copied.bytes += bytes;
        }
        next_height = segment.header.first_index;
    }
    copied.next_height = next_height;
    Ok(true)
}

/// Is what the node has of one piece with what is archived?
fn check_continues(
    target: &dyn Disk,
    archived: &[ScannedSegment],
    newest: &ScannedSegment,
    node: &[ScannedSegment],
) -> Result<(), Rejection> {
    let refuse = |what: &str, found: String| {
        Rejection::new(Code::BadFile, what).found(found).next("archive into a new directory; keep this one")
    };
    let mut common = false;
    for segment in archived {
        let Some(same) = node.iter().find(|other| other.header.sequence == segment.header.sequence) else { continue };
        if same.header != segment.header {
            let found = format!("{} here, {} in the archive: different salts or indexes", same.name, segment.name);
            return Err(refuse("the archive holds segments of another node", found));
        }
        common = true;
    }
    let Some(first) = node.first().filter(|_| !common) else { return Ok(()) };
    if first.header.begins_log() || first.header.sequence != newest.header.sequence + 1 {
        let found = format!(
            "an archive up to segment {}, and a node that begins with segment {}, block {}",
            newest.header.sequence, first.header.sequence, first.header.first_index
        );
        return Err(refuse("blocks between the archive and what the node still has are gone", found));
    }
    check_sealed(target, &newest.name, newest, first).map_err(|error| in_archive(&error))
}

/// Copies one segment, without the zeros behind it; none if the node has dropped it.
fn copy(
    source: &dyn Disk,
    target: &dyn Disk,
    segment: &ScannedSegment,
    next: &ScannedSegment,
) -> Result<Option<u64>, Rejection> {
    let part = format!("{}.part", segment.name);
    let end = u64::from(next.header.durable_upto.offset);
    let file = match source.open(&segment.name) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        file => file.map_err(|error| in_node(&StoreError::io("open", &segment.name, error)))?,
    };
    let write = || -> io::Result<()> {
        let copy = target.create(&part)?;
        let mut at = 0;
        while at < end {
            let mut piece = vec![0; usize::try_from(PIECE_BYTES.min(end - at)).unwrap_or(0)];
            let count = file.read_at(&mut piece, at)?;
            piece.truncate(count);
            copy.write_at(&piece, at)?;
            if count == 0 {
                break;
            }
            at += count as u64;
        }
        copy.sync_data()
    };
    let written = write().map_err(|error| full_or_failed("copy", &segment.name, end, error));
    let checked = written.and_then(|()| {
        check_sealed(target, &part, segment, next).map_err(|error| match error {
            StoreError::Corrupt { offset, what, index, .. } => StoreError::corrupt(&segment.name, offset, what, index),
            other => other,
        })
    });
    if let Err(error) = checked {
        let _ = target.remove(&part);
        return Err(in_node(&error));
    }
    let named = target.rename(&part, &segment.name).and_then(|()| target.sync_dir());
    named.map_err(|error| in_archive(&StoreError::io("rename", &part, error)))?;
    Ok(Some(end))
}

/// Removes what an interrupted run has left behind.
fn remove_parts(target: &dyn Disk) -> Result<(), StoreError> {
    let names = target.list().map_err(|error| StoreError::io("list", ".", error))?;
    for name in names.iter().filter(|name| name.strip_suffix(".part").is_some_and(|name| parse_name(name).is_some())) {
        target.remove(name).map_err(|error| StoreError::io("remove", name, error))?;
    }
    Ok(())
}

fn is_gone(error: &StoreError) -> bool {
    matches!(error, StoreError::Io { source, .. } if source.kind() == ErrorKind::NotFound)
}

fn full_or_failed(operation: &'static str, file: &str, wanted_bytes: u64, error: io::Error) -> StoreError {
    match error.kind() {
        ErrorKind::StorageFull => StoreError::DiskFull { operation, file: file.to_owned(), wanted_bytes },
        _ => StoreError::io(operation, file, error),
    }
}

fn in_node(error: &StoreError) -> Rejection {
    named("the node's block store", error)
}

fn in_archive(error: &StoreError) -> Rejection {
    named("the archive", error)
}

fn named(place: &str, error: &StoreError) -> Rejection {
    let rejection = Rejection::from(error.clone());
    Rejection { message: format!("{place}: {}", rejection.message), ..rejection }
}
