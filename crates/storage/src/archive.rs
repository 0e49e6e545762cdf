//! Writing a node's old blocks out, so that the node may drop them and they can still be verified, alone.
//!
//! An archive has the layout of a data directory: `genesis.json` and `blocks/` with finished segments. If they do not
//! begin at block 1, `snapshots/` has the snapshot from which they are executed. So whatever reads the one reads the
//! other. If one asks for all that is committed, the newest segment is copied up to its last committed block. It ends
//! there with a hard state that says so; the next run replaces that copy.

mod committed;
mod copy;
mod fault;
mod held;
mod segments;

use crate::disk::RealDisk;
use crate::layout::{BLOCKS_DIRECTORY, GENESIS_FILE, RESULTS_DIRECTORY, SNAPSHOTS_DIRECTORY};
use crate::results::ResultStore;
use ledger_base::durable::PUBLIC_MODE;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use segments::{Copied, Upto, Watching, copy_segments};
use serde::Serialize;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::Arc;

/// Names the network of a genesis; refuses what is no genesis.
pub type NetworkOf<'a> = &'a dyn Fn(&[u8]) -> Result<Hash, Rejection>;

/// Which blocks are archived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Those in finished segments: their files do not change any more.
    Finished,
    /// All that are committed and on the node's disk.
    Committed,
}

/// The present content of an archive.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Name of the network.
    pub network: Hash,
    /// Height of the oldest block archived.
    pub first_height: u64,
    /// Height of the newest block archived; one below the first if there is none yet.
    pub last_height: u64,
    /// How many blocks are archived.
    pub blocks: u64,
    /// Segments that were copied this time, with one that is not finished.
    pub segments_copied: u64,
    /// Their bytes.
    pub bytes_copied: u64,
    /// Height of the snapshot from which the blocks are executed; none if they begin at block 1.
    pub snapshot: Option<u64>,
}

/// How far an archive is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reached {
    /// Segments of the node that are looked at, and copied where they were lacking.
    pub segments: u64,
    /// Segments of the node.
    pub of_segments: u64,
    /// Bytes copied.
    pub bytes: u64,
}

/// Copies to `to` what it lacks of the blocks of the data directory `data`. The node may run meanwhile. May be
/// repeated: what is there stays, a segment that was not finished is replaced by more of it, and after a crash the rest
/// follows. `tell` is called after each segment.
///
/// # Errors
/// [`Code::BadFile`] if one of the directories cannot be used, or if the archive could not be verified with what would
/// be added (of another network or node, or a gap); [`Code::Corrupt`] naming file and byte if
/// a segment is damaged; [`Code::ChainInvalid`] if the node has other blocks than the archive; [`Code::DiskFull`].
pub fn archive(
    (data, to): (&Path, &Path),
    extent: Extent,
    network_of: NetworkOf<'_>,
    tell: &mut dyn FnMut(Reached),
) -> Result<Report, Rejection> {
    let genesis_path = data.join(GENESIS_FILE);
    let genesis = fs::read(&genesis_path).map_err(|error| {
        unusable("read", &genesis_path, &error).wanted("the data directory of a node, with genesis.json and blocks/")
    })?;
    let network = network_of(&genesis)?;
    let source = RealDisk::open_beside_writer(data.join(BLOCKS_DIRECTORY))
        .map_err(|error| unusable("open", &data.join(BLOCKS_DIRECTORY), &error))?;
    put_genesis(&genesis, to, network, network_of)?;
    let target = RealDisk::open(to.join(BLOCKS_DIRECTORY))
        .map_err(|error| unusable("open", &to.join(BLOCKS_DIRECTORY), &error))?;
    let upto = match extent {
        Extent::Finished => Upto::Finished,
        Extent::Committed => Upto::Committed(executed(data, network)),
    };
    let mut snapshot = None;
    // Before the blocks: an archive that begins above 1 never is without the snapshot.
    let begin = &mut |first| {
        snapshot = put_snapshot(data, to, first)?;
        Ok(())
    };
    let copied = copy_segments((&source, &target), &network.0, upto, Watching { begin, tell })?;
    let Copied { first_height, next_height, segments, bytes } = copied;
    Ok(Report {
        network,
        first_height,
        last_height: next_height.saturating_sub(1),
        blocks: next_height.saturating_sub(first_height),
        segments_copied: segments,
        bytes_copied: bytes,
        snapshot,
    })
}

/// The height up to which the node keeps results. A block that it has executed is committed, and was on the disk before
/// its result was; the log itself says so only with the next block. Results that cannot be read prove nothing.
fn executed(data: &Path, network: Hash) -> u64 {
    let results = RealDisk::open_beside_writer(data.join(RESULTS_DIRECTORY)).ok();
    let results = results.and_then(|disk| ResultStore::open(Arc::new(disk), network).ok());
    results.map_or(0, |results| results.next().saturating_sub(1))
}

/// Founds the archive, or makes sure that it is of this network.
fn put_genesis(genesis: &[u8], to: &Path, network: Hash, network_of: NetworkOf<'_>) -> Result<(), Rejection> {
    let path = to.join(GENESIS_FILE);
    match fs::read(&path) {
        Ok(found) if found == genesis => Ok(()),
        Ok(found) => {
            let found = network_of(&found).map_or_else(|wrong| wrong.message, |name| name.to_string());
            Err(Rejection::new(Code::BadFile, format!("{} is the archive of another network", to.display()))
                .found(found)
                .wanted(format!("network {network}"))
                .next("use a separate directory for each network"))
        }
        Err(error) if error.kind() == ErrorKind::NotFound => {
            fs::create_dir_all(to).map_err(|error| unusable("write", &path, &error))?;
            ledger_base::durable::replace(&path, genesis, PUBLIC_MODE)
        }
        Err(error) => Err(unusable("read", &path, &error)),
    }
}

/// Makes sure that blocks from `first` on can be executed: from the genesis, or from a snapshot that the archive has.
/// Answers with its height.
fn put_snapshot(data: &Path, to: &Path, first: u64) -> Result<Option<u64>, Rejection> {
    if first <= 1 {
        return Ok(None);
    }
    let target = to.join(SNAPSHOTS_DIRECTORY);
    if let Some(height) = oldest_snapshot(&target, first)? {
        return Ok(Some(height));
    }
    let source = data.join(SNAPSHOTS_DIRECTORY);
    let Some(height) = oldest_snapshot(&source, first)? else {
        return Err(Rejection::new(
            Code::BadFile,
            "the blocks cannot be archived in a form that can be verified alone",
        )
        .found(format!("blocks from {first} on, and no snapshot of height {} or above", first - 1))
        .wanted("blocks from 1 on, or a snapshot at the height before them")
        .next(format!("wait until the node has written a snapshot into {}", source.display())));
    };
    let name = snapshot_name(height);
    let opened = fs::create_dir_all(&target).and_then(|()| File::open(source.join(&name)));
    let mut content = opened.map_err(|error| unusable("copy", &source.join(&name), &error))?;
    ledger_base::durable::stage_from(&target.join(&name), &mut content, PUBLIC_MODE)?.publish()?;
    Ok(Some(height))
}

/// Height of the oldest snapshot in `directory` from which blocks that begin with `first` can be executed.
pub fn oldest_snapshot(directory: &Path, first: u64) -> Result<Option<u64>, Rejection> {
    let failed = |error: io::Error| unusable("read", directory, &error);
    let items = match fs::read_dir(directory) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        items => items.map_err(failed)?,
    };
    let mut oldest = None;
    for item in items {
        let name = item.map_err(failed)?.file_name();
        let height = name.to_str().and_then(|name| name.strip_suffix(".snap")?.parse::<u64>().ok());
        let usable = height.filter(|height| *snapshot_name(*height) == *name && height.saturating_add(1) >= first);
        oldest = match (oldest, usable) {
            (Some(oldest), Some(usable)) => Some(usable.min(oldest)),
            (oldest, usable) => oldest.or(usable),
        };
    }
    Ok(oldest)
}

/// Name of the file of a snapshot.
pub fn snapshot_name(height: u64) -> String {
    format!("{height:020}.snap")
}

fn unusable(operation: &str, path: &Path, error: &io::Error) -> Rejection {
    let code = if error.kind() == ErrorKind::StorageFull { Code::DiskFull } else { Code::BadFile };
    Rejection::new(code, format!("cannot {operation} {}: {error}", path.display()))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests;
