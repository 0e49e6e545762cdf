//! Offline verification of a node's data directory: every record, every hash, every signature, and every verdict
//! executed again.
//!
//! The blocks are read without trusting anything and executed into an empty state in memory, from the genesis on. What
//! the node has kept beside them (the savepoint and the results of blocks) must come out again. A byte changed by
//! somebody who also made the checksums fit is found by the signatures, or by the hashes of the results.

use crate::Hash;
use crate::block_store::StoreError;
use crate::chain::Ledger;
use crate::chaincode::Registry;
use crate::code::Code;
use crate::disk::RealDisk;
use crate::entry::Entry;
use crate::network::Genesis;
use crate::rejection::Rejection;
use crate::result::BlockResult;
use crate::segment::{Found, Record, scan};
use crate::state::{MemoryState, SledStore, State, Tip};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;

/// The genesis document of a node, in its data directory.
pub const GENESIS_FILE: &str = "genesis.json";
/// The block store of a node, in its data directory.
pub const BLOCKS_DIRECTORY: &str = "blocks";
/// The world state of a node, in its data directory.
pub const STATE_DIRECTORY: &str = "state";

/// Writes of the verified state that gather before they are moved together.
const DIRTY_BYTES_MAX: usize = 8 * 1024 * 1024;

/// What a verification found; only made if everything is right.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Name of the network.
    pub network: Hash,
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
    /// Entries after the last committed one: a node may hold them without having promised them.
    pub uncommitted: u64,
    /// Bytes of a write that was cut off and never acknowledged; the node removes them when it starts.
    pub torn_bytes: u64,
}

/// Verifies the data directory of a stopped node. `registry` holds the chaincodes of its network (`msp` is added).
///
/// # Errors
/// [`Code::ChainInvalid`] or [`Code::Corrupt`] naming file and byte of the first thing that is wrong,
/// [`Code::BadFile`] if the directory is none or is in use.
pub fn verify_directory(directory: &Path, registry: &Registry) -> Result<Report, Rejection> {
    let genesis_path = directory.join(GENESIS_FILE);
    let genesis = std::fs::read(&genesis_path).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot read {}: {error}", genesis_path.display()))
            .wanted("the data directory of a node, with genesis.json, blocks/ and state/")
    })?;
    let (_, network) = Genesis::from_bytes(&genesis)?;
    let blocks = directory.join(BLOCKS_DIRECTORY);
    let disk = RealDisk::open_read_only(&blocks).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot open {}: {error}", blocks.display()))
            .wanted("the data directory of a node that is not running")
            .next("stop the node first, or verify a copy of its directory")
    })?;
    let stored = stored_state(&directory.join(STATE_DIRECTORY))?;
    let state = Arc::new(State::open(Box::new(MemoryState::default()))?);
    let ledger = Ledger::open(&genesis, registry.clone(), Arc::clone(&state))?;
    let report = Report { network, ..Report::default() };
    let mut verification =
        Verification { ledger, state, stored, pending: VecDeque::new(), committed: 0, torn: None, report };
    verification.compare_tip("genesis.json")?;
    for found in scan(&disk, Some(&network.0)).map_err(|error| in_directory(&error))? {
        match found.map_err(|error| in_directory(&error))? {
            Found::Record { file, position, record: Record::Entry(entry), .. } => {
                verification.entry(entry, &format!("{BLOCKS_DIRECTORY}/{file} byte {}", position.offset))?;
            }
            Found::Record { record: Record::HardState(hard_state), .. } => verification.commit(hard_state.commit)?,
            Found::Torn { file, offset, bytes, what } => {
                verification.report.torn_bytes = bytes;
                verification.torn = Some(format!("{BLOCKS_DIRECTORY}/{file} byte {offset}: {what}"));
            }
        }
    }
    verification.finish()
}

fn in_directory(error: &StoreError) -> Rejection {
    Rejection::new(Code::Corrupt, format!("{BLOCKS_DIRECTORY}/{error}"))
}

/// The state that the node has kept, if there is one that can be read.
fn stored_state(directory: &Path) -> Result<Option<State>, Rejection> {
    if !directory.is_dir() {
        return Ok(None);
    }
    SledStore::open(directory).and_then(|store| State::open(Box::new(store))).map(Some).map_err(|rejection| {
        Rejection { message: format!("{STATE_DIRECTORY}/: {}", rejection.message), ..rejection }
            .next("stop the node if it runs; a damaged state directory can be deleted, the node rebuilds it")
    })
}

struct Verification {
    ledger: Ledger,
    state: Arc<State>,
    stored: Option<State>,
    /// Entries that are not known to be committed yet, and where they stand.
    pending: VecDeque<(Entry, String)>,
    committed: u64,
    /// Where the log breaks off, and what is wrong there, if it does not end properly.
    torn: Option<String>,
    report: Report,
}

impl Verification {
    fn entry(&mut self, entry: Entry, place: &str) -> Result<(), Rejection> {
        if entry.index <= self.ledger.tip().height {
            return Err(wrong(place, format!("block {} is written again after it was committed", entry.index)));
        }
        self.pending.retain(|(pending, _)| pending.index < entry.index);
        self.pending.push_back((entry, place.to_owned()));
        Ok(())
    }

    /// Everything up to this height is committed: executes it.
    fn commit(&mut self, height: u64) -> Result<(), Rejection> {
        self.committed = self.committed.max(height);
        while let Some((entry, place)) = self.pending.pop_front_if(|(entry, _)| entry.index <= self.committed) {
            let outcome = self.ledger.apply(&entry).map_err(|fault| wrong(&place, fault.to_string()))?;
            self.report.transactions += outcome.results.len() as u64;
            for result in &outcome.results {
                *self.report.verdicts.entry(result.code().name()).or_default() += 1;
            }
            self.compare_result(entry.index, &place)?;
            self.compare_tip(&place)?;
            if self.state.dirty_bytes() > DIRTY_BYTES_MAX {
                self.state.flush()?;
            }
        }
        Ok(())
    }

    /// What the node kept of a block must be what executing it gives.
    fn compare_result(&mut self, height: u64, place: &str) -> Result<(), Rejection> {
        let Some(computed) = self.ledger.result(height)? else { return Ok(()) };
        let kept =
            self.stored.as_ref().map(|stored| crate::chain::stored_result(stored, height)).transpose()?.flatten();
        let Some(kept) = kept else { return check_signed(&computed, height, place) };
        self.report.results_compared += 1;
        match difference(&computed, &kept) {
            None => Ok(()),
            Some(what) => {
                Err(wrong(place, format!("block {height} does not give the result that the node kept: {what}")))
            }
        }
    }

    /// At the height of the savepoint, hash and digest must be the same.
    fn compare_tip(&mut self, place: &str) -> Result<(), Rejection> {
        let (computed, Some(kept)) = (self.ledger.tip(), self.stored.as_ref().and_then(State::tip)) else {
            return Ok(());
        };
        if kept.height != computed.height {
            return Ok(());
        }
        self.report.state_compared = true;
        if kept == computed {
            return Ok(());
        }
        let Tip { height, hash, digest, .. } = computed;
        Err(wrong(place, format!("the savepoint at height {height} does not fit the blocks"))
            .found(format!("block hash {}, state digest {}", kept.hash, kept.digest))
            .wanted(format!("block hash {hash}, state digest {digest}")))
    }

    fn finish(mut self) -> Result<Report, Rejection> {
        // Executed means committed, even if the log did not get to say so before the node was killed.
        let executed = self.stored.as_ref().and_then(State::tip).map_or(0, |tip| tip.height);
        self.commit(executed)?;
        let tip = self.ledger.tip();
        if tip.height < executed {
            let place = self.torn.map(|torn| format!("{torn}, and ")).unwrap_or_default();
            let what = format!("{place}the world state has executed blocks that are not there");
            return Err(Rejection::new(Code::ChainInvalid, what)
                .found(format!("blocks up to height {}", tip.height))
                .wanted(format!("blocks up to height {executed}")));
        }
        self.report.uncommitted = self.pending.len() as u64;
        Ok(Report { height: tip.height, block_hash: tip.hash, state_digest: tip.digest, ..self.report })
    }
}

/// Nodes order only what they have admitted. Where nothing was kept that shows such a transaction to have been ordered as
/// it is, one that nobody can have signed means that somebody has changed it since.
fn check_signed(computed: &BlockResult, height: u64, place: &str) -> Result<(), Rejection> {
    let forged = |code| matches!(code, Code::BadSignature | Code::Malformed);
    match computed.results.iter().position(|result| forged(result.code())) {
        None => Ok(()),
        Some(index) => Err(wrong(place, format!("nobody has signed transaction {index} of block {height} as it is"))),
    }
}

/// The first thing in which two results differ.
fn difference(computed: &BlockResult, kept: &BlockResult) -> Option<String> {
    if computed.previous != kept.previous || computed.root != kept.root {
        return Some("another hash".into());
    }
    for (index, (computed, kept)) in computed.results.iter().zip(&kept.results).enumerate() {
        if computed != kept {
            return Some(format!("transaction {index}: found {}, wanted {}", computed.code(), kept.code()));
        }
    }
    (computed != kept).then(|| "another state digest or other events".into())
}

fn wrong(place: &str, what: String) -> Rejection {
    Rejection::new(Code::ChainInvalid, format!("{place}: {what}"))
        .next("compare with the directory of another node; this one can be emptied, it fetches the chain again")
}
