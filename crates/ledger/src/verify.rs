//! Offline verification of a node's data directory: every record, every hash, every signature, and every verdict
//! executed again.
//!
//! The blocks are read without trusting anything and executed into an empty state in memory, from the genesis on. The
//! node's records beside them (the savepoint and the results of blocks) must come out again. A byte changed by somebody
//! who also made the checksums fit is found by the signatures, or by the hashes of the results.

mod attested;
mod begin;
mod replay;

use crate::chaincode::Registry;
use crate::network::Genesis;
use begin::Beginning;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Checkpoint;
use ledger_storage::block_store::{StoreError, check_oldest};
use ledger_storage::disk::{Disk, DiskFile, RealDisk};
use ledger_storage::layout::{BLOCKS_DIRECTORY, GENESIS_FILE, RESULTS_DIRECTORY, STATE_DIRECTORY};
use ledger_storage::results::ResultStore;
use ledger_storage::segment::{Found, Record, scan};
use ledger_storage::state::{SledStore, State};
use replay::Verification;
use serde::Serialize;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;

pub use attested::Dissent;
pub use begin::Begun;

/// Bytes that are read at a time to find the end of what was written.
const PIECE_BYTES: usize = 1 << 20;

/// The report of a verification; only made if everything is right.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Name of the network.
    pub network: Hash,
    /// Height of the first block that was executed.
    pub first_height: u64,
    /// The snapshot that it was executed on; none if it is block 1.
    pub begun: Option<Begun>,
    /// Height of the last block known to be committed.
    pub height: u64,
    /// Hash of its header.
    pub block_hash: Hash,
    /// State digest after it.
    pub state_digest: Hash,
    /// Transactions in the blocks.
    pub transactions: u64,
    /// Verdicts, by name of the code.
    pub verdicts: BTreeMap<&'static str, u64>,
    /// Blocks whose stored result was compared; the rest had none, for example because the node was killed.
    pub results_compared: u64,
    /// Was the stored world state's savepoint reached and equal?
    pub state_compared: bool,
    /// The checkpoint that was compared, by its height; none if none was given.
    pub against: Option<u64>,
    /// Attestations of nodes that say the same as these blocks.
    pub attestations_agreeing: u64,
    /// Those that say something else, of fewer nodes than agree: these nodes were wrong. At most 100.
    pub dissents: Vec<Dissent>,
    /// Entries after the last one known to be committed: a node may hold them without having promised them. At the end
    /// of an archive of finished segments it is the next segment that tells.
    pub uncommitted: u64,
    /// Bytes of a write that was cut off and never acknowledged; the node removes them when it starts.
    pub torn_bytes: u64,
}

/// How far a verification is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reached {
    /// Height of the last block that was executed.
    pub height: u64,
    /// Transactions that were executed.
    pub transactions: u64,
    /// Bytes of blocks that were read.
    pub bytes: u64,
    /// Bytes of blocks in all.
    pub of_bytes: u64,
}

/// Verifies the data directory of a stopped node, or an archive. `registry` holds the chaincodes of its network (`msp`
/// is added). With a `checkpoint` the blocks must give what voters have signed. `tell` is called after every commit.
///
/// # Errors
/// [`Code::ChainInvalid`] or [`Code::Corrupt`] naming file and byte of the first fault, or height and nodes of
/// attestations that contradict the blocks; [`Code::BadFile`] if the directory is none or is in use, or if its blocks
/// begin above 1 and there is no snapshot to begin from. With a checkpoint also [`Code::ChainInvalid`] if the blocks give
/// something else at its height or do not reach it, and [`Code::WrongNetwork`] and others if it is none of this network.
pub fn verify_directory(
    directory: &Path,
    registry: &Registry,
    checkpoint: Option<&[u8]>,
    tell: &mut dyn FnMut(Reached),
) -> Result<Report, Rejection> {
    let genesis_path = directory.join(GENESIS_FILE);
    let genesis = std::fs::read(&genesis_path).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot read {}: {error}", genesis_path.display()))
            .wanted("the data directory of a node or an archive, with genesis.json and blocks/")
    })?;
    let (_, network) = Genesis::from_bytes(&genesis)?;
    let checkpoint = checkpoint.map(|bytes| Checkpoint::from_bytes(&network, bytes)).transpose()?;
    let blocks = directory.join(BLOCKS_DIRECTORY);
    let disk = RealDisk::open_read_only(&blocks).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot open {}: {error}", blocks.display()))
            .wanted("the data directory of a node that is not running")
            .next("stop the node first, or verify a copy of its directory")
    })?;
    let kept = (stored_state(&directory.join(STATE_DIRECTORY))?, stored_results(directory, network)?);
    let length = Length::of(&disk).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot read {}: {error}", blocks.display())).wanted("readable files")
    })?;
    let records = scan(&disk, Some(&network.0)).map_err(|error| in_directory(&error))?;
    check_oldest(&disk, &records).map_err(|error| in_directory(&error))?;
    let beginning = Beginning::find(directory, &genesis, registry, records.base())?;
    let signed = checkpoint.map(|checkpoint| checkpoint.proof.certificate.statement);
    let mut verification = Verification::begin(beginning, kept, Report { network, ..Report::default() })?;
    verification.compare_with(signed);
    for found in records {
        match found.map_err(|error| in_directory(&error))? {
            Found::Record { file, position, record: Record::Entry(entry), .. } => {
                verification.entry(entry, &format!("{BLOCKS_DIRECTORY}/{file} byte {}", position.offset))?;
            }
            Found::Record { file, position, bytes, record: Record::HardState(hard_state), .. } => {
                verification.commit(hard_state.commit)?;
                let bytes = length.before(&file) + u64::from(position.offset) + u64::from(bytes);
                // The last record may itself end in zeros, which `written` does not count.
                tell(Reached { bytes, of_bytes: length.in_all.max(bytes), ..verification.reached() });
            }
            // The scan has compared it with the segment before.
            Found::Record { record: Record::Seal(_), .. } => {}
            Found::Torn { file, offset, bytes, what } => {
                verification.torn(bytes, format!("{BLOCKS_DIRECTORY}/{file} byte {offset}: {what}"));
            }
        }
    }
    verification.finish()
}

/// The length of the log, so that it can be told how much of it is read.
struct Length {
    /// For each file the bytes of those before it.
    before: BTreeMap<String, u64>,
    in_all: u64,
}

impl Length {
    /// Of these segments, whose names sort as they follow each other.
    fn of(disk: &RealDisk) -> io::Result<Self> {
        let (mut before, mut in_all) = (BTreeMap::new(), 0);
        let names = disk.list()?;
        for name in &names {
            let file = disk.open(name)?;
            before.insert(name.clone(), in_all);
            in_all += if Some(name) == names.last() { written(&*file)? } else { file.len()? };
        }
        Ok(Self { before, in_all })
    }

    fn before(&self, file: &str) -> u64 {
        self.before.get(file).copied().unwrap_or_default()
    }
}

/// The bytes of a file without the zeros at its end: the newest segment is made as long as it may become.
fn written(file: &dyn DiskFile) -> io::Result<u64> {
    let (mut end, mut piece) = (file.len()?, vec![0; PIECE_BYTES]);
    while end > 0 {
        let start = end.saturating_sub(PIECE_BYTES as u64);
        let read = file.read_at(&mut piece, start)?;
        let piece = piece.get(..read.min((end - start) as usize)).unwrap_or_default();
        if let Some(last) = piece.iter().rposition(|byte| *byte != 0) {
            return Ok(start + last as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}

fn in_directory(error: &StoreError) -> Rejection {
    Rejection::new(Code::Corrupt, format!("{BLOCKS_DIRECTORY}/{error}"))
}

/// The state that the node has kept, if there is one that can be read: from a copy, so that nothing is written.
fn stored_state(directory: &Path) -> Result<Option<State>, Rejection> {
    if !directory.is_dir() {
        return Ok(None);
    }
    SledStore::open_copy(directory).and_then(|store| State::open(Box::new(store))).map(Some).map_err(|rejection| {
        rejection.prefix(format_args!("{STATE_DIRECTORY}/: ")).next(
            "stop the node if it runs; a damaged directory state/ can then be deleted, and is rebuilt from the \
                   blocks",
        )
    })
}

/// The results that the node has kept, if it has.
fn stored_results(directory: &Path, network: Hash) -> Result<Option<ResultStore>, Rejection> {
    let directory = directory.join(RESULTS_DIRECTORY);
    if !directory.is_dir() {
        return Ok(None);
    }
    let disk = RealDisk::open_read_only(&directory).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot open {}: {error}", directory.display()))
            .next("stop the node first, or verify a copy of its directory")
    })?;
    ResultStore::open(Arc::new(disk), network).map(Some)
}

fn wrong(place: &str, what: String) -> Rejection {
    Rejection::new(Code::ChainInvalid, format!("{place}: {what}"))
}
