//! The audit: keeps an index of who did what, beside the work, and answers from it.
//!
//! ```text
//! audit             follows executed blocks, seconds behind them, or at once when somebody asks
//!   rows            the decisions of one block
//!     action        the actions that policies decide about
//!     certificates  whose they are, and which of them end
//! ```
//!
//! The threads that order and execute know nothing of it: it reads blocks as any other reader does. After a start it goes on
//! where it was. An index that is lost is made again from the blocks that the node has.

mod action;
mod certificates;
mod rows;

use crate::storage::Storage;
use ledger::Outcome;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::certificate::Certificate;
use ledger_replica::space::Wrote;
use ledger_storage::audit::{Block, Holder, Index, Known, Page, Question, Row};
use ledger_storage::layout::AUDIT_DIRECTORY;
use ledger_storage::state::SledStore;
use rows::Names;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::Mutex;
use tokio::time::timeout;

/// The chaincode of robots.
const ABAC: &str = "abac";
/// Time between two writes of the index, unless blocks are large.
const EVERY: Duration = Duration::from_secs(2);
/// How long it takes blocks at once.
const TURN: Duration = Duration::from_millis(500);
/// Blocks whose rows are written at once.
const BLOCKS_AT_ONCE: usize = 4096;
/// How long somebody who asks waits for the index to be made.
const PATIENCE: Duration = Duration::from_secs(2);
/// Writes of the index between two looks for rows that are too old.
const WRITES_BETWEEN_PRUNES: u64 = 300;

/// The index of a node, and what it follows.
pub(crate) struct Audit {
    storage: Arc<Storage>,
    index: Index,
    /// Held while the index takes blocks.
    taking: Arc<Mutex<Taking>>,
}

#[derive(Default)]
struct Taking {
    names: Names,
    writes: u64,
}

impl Audit {
    /// The index in a data directory. One that cannot be read is made again.
    ///
    /// # Errors
    /// [`Code::DiskFailed`], [`Code::BadFile`] if it cannot be made.
    pub(crate) fn open(storage: &Arc<Storage>) -> Result<Arc<Self>, Rejection> {
        let directory = storage.data.join(AUDIT_DIRECTORY);
        let index = match open(&directory) {
            Err(full) if full.code == Code::DiskFull && storage.space.wrote(Wrote::NoRoom) => open(&directory)?,
            opened => opened?,
        };
        Ok(Arc::new(Self { storage: Arc::clone(storage), index, taking: Arc::default() }))
    }

    /// Follows the blocks until the node stops.
    pub(crate) async fn keep(self: Arc<Self>) {
        let mut head = self.storage.blocks.head();
        loop {
            // In turns, so that a long way does not keep the node from stopping.
            while self.is_behind() {
                if let Err(fault) = self.follow(Instant::now() + TURN).await {
                    tracing::warn!(code = fault.code.name(), reason = %fault, "audit index does not follow the blocks");
                    break;
                }
            }
            // Later it would have to read from the disk what is in memory now.
            let _ = timeout(EVERY, self.storage.blocks.half_forgotten()).await;
            if head.changed().await.is_err() {
                return;
            }
        }
    }

    /// Takes the blocks that the index lacks, as far as that takes no longer than two seconds.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) async fn refresh(self: &Arc<Self>) -> Result<(), Rejection> {
        let deadline = Instant::now() + PATIENCE;
        if !self.is_behind() {
            return Ok(());
        }
        // It goes on beside if that takes longer, and the answer says how far it was.
        timeout(PATIENCE, self.follow(deadline)).await.unwrap_or(Ok(()))
    }

    /// Are there blocks that it lacks, and room on the disk for their rows?
    fn is_behind(&self) -> bool {
        let known = self.index.known().map_or(0, |known| known.height);
        known < self.storage.blocks.height() && self.storage.space.check(|| false).is_ok()
    }

    /// An answer from the index as it is.
    ///
    /// # Errors
    /// A fault of the store.
    pub(crate) fn find(
        &self,
        question: &Question,
        shown: impl FnMut(&Row) -> bool,
    ) -> Result<(Page, Option<Known>), Rejection> {
        let known = self.index.known();
        let mut page = self.index.find(question, shown)?;
        for row in page.rows.iter_mut().filter(|row| row.is_use() && row.epoch > 0) {
            (row.policy_version, row.policies) = self.index.policies_of(&row.subject, row.epoch)?;
        }
        Ok((page, known))
    }

    /// Takes the blocks that the index lacks, until a moment. One after the other: whoever waits takes no thread.
    async fn follow(self: &Arc<Self>, deadline: Instant) -> Result<(), Rejection> {
        let mut taking = Arc::clone(&self.taking).lock_owned().await;
        let audit = Arc::clone(self);
        let taken = tokio::task::spawn_blocking(move || audit.take_until(&mut taking, deadline)).await;
        taken.map_err(|_| Rejection::new(Code::Internal, "a thread panicked while it updated the audit index"))?
    }

    fn take_until(&self, taking: &mut Taking, deadline: Instant) -> Result<(), Rejection> {
        let taken = self.take_blocks(taking, deadline);
        if taken.is_err() {
            // The same blocks come again, and must tell again whom they name.
            taking.names = Names::default();
        }
        taken
    }

    fn take_blocks(&self, taking: &mut Taking, deadline: Instant) -> Result<(), Rejection> {
        loop {
            let blocks = self.next_blocks(&mut taking.names)?;
            if blocks.is_empty() {
                return self.prune(taking);
            }
            self.index.add(&blocks)?;
            taking.writes += 1;
            if deadline < Instant::now() {
                return Ok(());
            }
        }
    }

    /// The next blocks that the index lacks.
    fn next_blocks(&self, names: &mut Names) -> Result<Vec<Block>, Rejection> {
        let next = self.index.known().map_or(1, |known| known.height + 1);
        let next = next.max(self.storage.blocks.first_height().max(1));
        let mut taken: Vec<Block> = Vec::new();
        for height in next..=self.storage.blocks.height() {
            if taken.len() == BLOCKS_AT_ONCE {
                break;
            }
            match self.storage.blocks.get(height)? {
                Some(outcome) => taken.push(self.block(&outcome, names)),
                // The results of the first blocks after a snapshot are not there.
                None if taken.is_empty() => {}
                None => break,
            }
        }
        Ok(taken)
    }

    fn block(&self, outcome: &Outcome, names: &mut Names) -> Block {
        let (rows, holders) = names.rows(outcome, |creator| self.signer(creator));
        Block { height: outcome.header.height, time: outcome.header.time, rows, holders }
    }

    /// A creator that the ledger knows.
    fn signer(&self, creator: &Hash) -> Option<Holder> {
        let name = self.storage.ledger.creator_name(creator)?;
        let parsed = Certificate::parse(&self.storage.ledger.certificate(creator).ok()??).ok()?;
        let certificate = certificates::named(&self.storage.ledger.msps().issuer(&parsed.issuer_name), &parsed.serial);
        Some(Holder { certificate, name })
    }

    /// Forgets what is about blocks that the node has dropped.
    fn prune(&self, taking: &Taking) -> Result<(), Rejection> {
        if !taking.writes.is_multiple_of(WRITES_BETWEEN_PRUNES) {
            return Ok(());
        }
        let first = self.storage.blocks.first_height();
        let Some(oldest) = self.storage.ledger.block_hashes(first)? else { return Ok(()) };
        while self.index.prune(first, oldest.time)? {}
        Ok(())
    }
}

/// Opens the index; one that cannot be read is deleted first.
fn open(directory: &Path) -> Result<Index, Rejection> {
    let opened = SledStore::open(directory).and_then(|store| Index::open(Box::new(store)));
    let fault = match opened {
        Err(fault) if fault.code == Code::Corrupt => fault,
        opened => return opened,
    };
    let reason = format!("{}: {}", fault.message, fault.found);
    tracing::warn!(code = fault.code.name(), reason, "audit index damaged; rebuilding it from the blocks");
    std::fs::remove_dir_all(directory).map_err(|error| {
        Rejection::new(Code::BadFile, format!("cannot delete {}: {error}", directory.display()))
            .next("delete this file of the index manually; it is rebuilt from the blocks")
    })?;
    Index::open(Box::new(SledStore::open(directory)?))
}
