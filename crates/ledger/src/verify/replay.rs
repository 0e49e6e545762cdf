//! Executing the blocks again and comparing with what the node kept.

use super::attested::Attested;
use super::begin::{Beginning, Begun};
use super::{Reached, Report, wrong};
use crate::chain::{Ledger, Outcome};
use crate::foretold::complete;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_light::Statement;
use ledger_storage::entry::Entry;
use ledger_storage::layout::RESULTS_DIRECTORY;
use ledger_storage::result::BlockResult;
use ledger_storage::results::ResultStore;
use ledger_storage::state::{State, Tip};
use std::collections::VecDeque;

/// Writes of the verified state that gather before they are moved together.
const DIRTY_BYTES_MAX: usize = 8 * 1024 * 1024;

pub(super) struct Verification {
    ledger: Ledger,
    /// The records of the node.
    stored: Option<State>,
    results: Option<ResultStore>,
    attested: Attested,
    /// The snapshot that was begun from: its height and content.
    snapshot: Option<(u64, Hash)>,
    /// Height and term of the newest block that is in the state already.
    begun: Tip,
    /// Entries that are not known to be committed yet, and where they stand.
    pending: VecDeque<(Entry, String)>,
    committed: u64,
    /// Where the log breaks off, and what is wrong there, if it does not end properly.
    torn: Option<String>,
    /// The statement that voters have signed, until it was compared.
    signed: Option<Statement>,
    report: Report,
}

impl Verification {
    pub(super) fn begin(
        beginning: Beginning,
        (stored, results): (Option<State>, Option<ResultStore>),
        report: Report,
    ) -> Result<Self, Rejection> {
        let Beginning { ledger, snapshot } = beginning;
        let begun = ledger.tip();
        let mut attested = Attested::default();
        attested.computed(&begun)?;
        if let Some((height, content)) = snapshot {
            attested.begin(height, content);
        }
        let report = Report { first_height: begun.height + 1, ..report };
        let (pending, committed) = (VecDeque::new(), begun.height);
        let mut verification = Self {
            ledger,
            stored,
            results,
            attested,
            snapshot,
            begun,
            pending,
            committed,
            torn: None,
            signed: None,
            report,
        };
        verification.compare_tip("the initial state")?;
        Ok(verification)
    }

    /// The signed statement must come out of these blocks.
    pub(super) fn compare_with(&mut self, signed: Option<Statement>) {
        self.signed = signed;
    }

    /// The log ends with a write that was cut off.
    pub(super) fn torn(&mut self, bytes: u64, place: String) {
        self.report.torn_bytes = bytes;
        self.torn = Some(place);
    }

    pub(super) fn entry(&mut self, entry: Entry, place: &str) -> Result<(), Rejection> {
        let reached = self.ledger.tip().height;
        if entry.index <= reached && reached > self.begun.height {
            return Err(wrong(place, format!("block {} was written again after its commit", entry.index)));
        }
        self.pending.retain(|(pending, _)| pending.index < entry.index);
        if entry.index <= reached {
            return self.skip(&entry, place);
        }
        self.pending.push_back((entry, place.to_owned()));
        Ok(())
    }

    /// An entry that is in the snapshot already. Only the last of them can be compared: with its term.
    fn skip(&self, entry: &Entry, place: &str) -> Result<(), Rejection> {
        let Tip { height, term, .. } = self.begun;
        let superseded = entry.index == height && entry.term < term;
        if height == 0 || entry.index < height || entry.term == term || superseded {
            return Ok(());
        }
        Err(wrong(place, format!("block {height} differs from the snapshot"))
            .found(format!("term {}", entry.term))
            .wanted(format!("term {term}")))
    }

    /// Everything up to this height is committed: executes it.
    pub(super) fn commit(&mut self, height: u64) -> Result<(), Rejection> {
        self.committed = self.committed.max(height);
        while let Some((entry, place)) = self.pending.pop_front_if(|(entry, _)| entry.index <= self.committed) {
            let outcome = self.ledger.apply(&entry).map_err(|fault| wrong(&place, fault.to_string()))?;
            self.report.transactions += outcome.results.len() as u64;
            for result in &outcome.results {
                *self.report.verdicts.entry(result.code().name()).or_default() += 1;
            }
            self.compare_result(&entry, &place)?;
            self.compare_tip(&place)?;
            self.compare_signed(&outcome, &place)?;
            self.attested.computed(&self.ledger.tip())?;
            self.attested.block(&outcome)?;
            if self.ledger.pending_bytes() > DIRTY_BYTES_MAX {
                self.ledger.flush(None)?;
            }
        }
        Ok(())
    }

    /// How far the execution is.
    pub(super) fn reached(&self) -> Reached {
        let (height, transactions) = (self.ledger.tip().height, self.report.transactions);
        Reached { height, transactions, ..Reached::default() }
    }

    /// The node's record of a block must equal the result of executing it.
    fn compare_result(&mut self, block: &Entry, place: &str) -> Result<(), Rejection> {
        let height = block.index;
        let Some(computed) = self.ledger.result(height)? else { return Ok(()) };
        let kept = self.results.as_ref().map(|results| results.get(height)).transpose()?.flatten();
        let Some(kept) = kept else { return check_signed(&computed, height, place) };
        self.report.results_compared += 1;
        let difference = if computed.hash() == kept.hash() {
            match complete(kept, block, self.ledger.registry()) {
                Ok(kept) => difference(&computed, &kept),
                Err(apart) => Some(apart.message),
            }
        } else {
            Some("another hash".into())
        };
        match difference {
            None => Ok(()),
            Some(what) => Err(wrong(place, format!("block {height} does not result in the stored result: {what}"))),
        }
    }

    /// At the height of the checkpoint, the block and its results must be what voters have signed.
    fn compare_signed(&mut self, outcome: &Outcome, place: &str) -> Result<(), Rejection> {
        let height = outcome.header.height;
        let Some(signed) = self.signed.take_if(|signed| signed.height == height) else { return Ok(()) };
        let results = outcome.certifiable.map(|roots| roots.results);
        if (signed.block, Some(signed.results)) != (outcome.hash, results) {
            return Err(wrong(
                place,
                format!(
                    "block {height} differs from the block that voters signed, according to \
                                             the checkpoint"
                ),
            )
            .found(format!("block {}, results root {}", outcome.hash, results.unwrap_or(Hash::ZERO)))
            .wanted(format!("block {}, results root {}", signed.block, signed.results)));
        }
        self.report.against = Some(height);
        Ok(())
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
        Err(wrong(place, format!("the savepoint at height {height} does not match the blocks"))
            .found(format!("block hash {}, state digest {}", kept.hash, kept.digest))
            .wanted(format!("block hash {hash}, state digest {digest}")))
    }

    pub(super) fn finish(mut self) -> Result<Report, Rejection> {
        // Executed means committed, even if the log did not get to say so before the node was killed.
        let executed = self.stored.as_ref().and_then(State::tip).map_or(0, |tip| tip.height);
        self.commit(executed)?;
        let tip = self.ledger.tip();
        if tip.height < executed {
            let place = self.torn.map(|torn| format!("{torn}, and ")).unwrap_or_default();
            let what = format!("{place}the world state includes blocks that are missing");
            return Err(Rejection::new(Code::ChainInvalid, what)
                .found(format!("blocks up to height {}", tip.height))
                .wanted(format!("blocks up to height {executed}")));
        }
        if let Some(results) = self.results.as_ref().filter(|results| results.next() <= executed) {
            return Err(Rejection::new(Code::Corrupt, format!("{RESULTS_DIRECTORY}/ is damaged: results are missing"))
                .found(format!("results up to height {}", results.next() - 1))
                .wanted(format!("results up to height {executed}"))
                .next(
                    "delete the directories state/ and results/ while the node is stopped; both are rebuilt from \
                       the blocks",
                ));
        }
        if let Some(signed) = &self.signed {
            let what = "the blocks do not include the one that voters signed, according to the checkpoint".to_owned();
            return Err(Rejection::new(Code::ChainInvalid, what)
                .found(format!("blocks {} to {}", self.report.first_height, tip.height))
                .wanted(format!("block {}", signed.height))
                .next("use a checkpoint of a block between these, or a newer copy of the directory"));
        }
        self.attested.finish()?;
        self.report.uncommitted = self.pending.len() as u64;
        self.report.attestations_agreeing = self.attested.agreeing;
        self.report.dissents = self.attested.dissents;
        self.report.begun = self.snapshot.map(|(height, content)| {
            let attested_by = self.attested.snapshot_attested_by;
            Begun { height, content, attested_by }
        });
        Ok(Report { height: tip.height, block_hash: tip.hash, state_digest: tip.digest, ..self.report })
    }
}

/// Nodes order only what they have admitted. Where nothing was kept that shows such a transaction to have been ordered
/// as it is, one that nobody can have signed means that somebody has changed it since.
fn check_signed(computed: &BlockResult, height: u64, place: &str) -> Result<(), Rejection> {
    let forged = |code| matches!(code, Code::BadSignature | Code::Malformed);
    match computed.results.iter().position(|result| forged(result.code())) {
        None => Ok(()),
        Some(index) => Err(wrong(place, format!("transaction {index} of block {height} has no valid signature"))),
    }
}

/// The first thing in which two results differ.
fn difference(computed: &BlockResult, kept: &BlockResult) -> Option<String> {
    for (index, (computed, kept)) in computed.results.iter().zip(&kept.results).enumerate() {
        if computed != kept {
            return Some(format!("transaction {index}: found {}, wanted {}", computed.code(), kept.code()));
        }
    }
    (computed != kept).then(|| "another state digest or other events".into())
}
