//! Opening what a node computed: the world state is rebuilt if there is any doubt about it, as the blocks are the truth.

use crate::REJOIN;
use ledger::block::Header;
use ledger::{Ledger, Registry};
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::block_store::BlockStore;
use ledger_storage::entry::Entry;
use ledger_storage::results::ResultStore;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::{State, Store};
use std::sync::Arc;

/// Entries read at once while blocks are executed again.
const REPLAY_BYTES: usize = 4 << 20;
/// World state in memory that is moved to the store while blocks are executed again.
const DIRTY_BYTES_MAX: usize = 16 << 20;

/// Where a node keeps what it computed: world state and results.
pub trait Kept {
    /// The world state, empty if there is none.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if it is damaged.
    fn state(&mut self) -> Result<Box<dyn Store>, Rejection>;

    /// The results of blocks, which may read what they lack from these blocks.
    ///
    /// # Errors
    /// As [`Kept::state`].
    fn results(&mut self, blocks: &Arc<BlockStore>) -> Result<ResultStore, Rejection>;

    /// Moves both out of the way: the next call finds them empty.
    ///
    /// # Errors
    /// If they cannot be moved.
    fn set_aside(&mut self) -> Result<(), Rejection>;

    /// Executes a block that is committed and that the world state has not seen.
    ///
    /// # Errors
    /// As [`Ledger::apply`].
    fn replay(&mut self, ledger: &Ledger, block: &Entry) -> Result<(), Rejection> {
        ledger.apply(block).map(drop)
    }
}

/// The other parts that a node begins with.
pub struct Opening<'a> {
    /// The genesis document.
    pub genesis: &'a [u8],
    /// The chaincodes.
    pub registry: &'a Registry,
    /// The log.
    pub store: &'a Arc<BlockStore>,
    /// The world state at some heights.
    pub snapshots: &'a Snapshots,
    /// Most other nodes contradicted this one when it ran last.
    pub diverged: bool,
    /// Height and hash of the newest block for which the node has a certificate. It is committed, whatever the log says of that.
    pub certified: Option<(u64, Hash)>,
}

impl Opening<'_> {
    /// Opens the ledger. Everything that is known to be committed is executed then.
    ///
    /// # Errors
    /// Damage that cannot be repaired; a log that has lost what was promised; a fault of the disk.
    pub fn open(&self, kept: &mut impl Kept) -> Result<Ledger, Rejection> {
        if self.diverged {
            kept.set_aside()?;
            tracing::warn!(
                "world state and results differed from those of other nodes; rebuilding them from the blocks"
            );
        }
        match self.open_once(kept) {
            Err(fault) if fault.code == Code::Corrupt => {
                kept.set_aside()?;
                tracing::warn!(code = fault.code.name(), reason = %fault, "world state and results set aside; \
                                                                           rebuilding them from the blocks");
                self.open_once(kept)
            }
            opened => opened,
        }
    }

    fn open_once(&self, kept: &mut impl Kept) -> Result<Ledger, Rejection> {
        let (state, results) = (kept.state()?, kept.results(self.store)?);
        if self.store.first_index() > 1 && state.range(b"", None, 1)?.is_empty() {
            self.fill(&*state, &results)?;
        }
        let state = Arc::new(State::open(state)?);
        let ledger = Ledger::open(self.genesis, self.registry.clone(), state, Arc::new(results))?;
        self.check(&ledger)?;
        self.execute_the_rest(&ledger, kept)?;
        Ok(ledger)
    }

    /// The blocks begin above 1: execution begins with the newest snapshot.
    fn fill(&self, kept: &dyn Store, results: &ResultStore) -> Result<(), Rejection> {
        let first = self.store.first_index();
        let usable = self.snapshots.newest().filter(|snapshot| snapshot.manifest().height + 1 >= first);
        let Some(snapshot) = usable else {
            return Err(Rejection::new(
                Code::ChainInvalid,
                "the world state cannot be rebuilt, because older blocks were dropped",
            )
            .found(format!("blocks from {first} on, and no snapshot of height {} or above", first - 1))
            .next(format!("{REJOIN}: it comes back as a new node and fetches everything again")));
        };
        tracing::info!(height = snapshot.manifest().height, content = %snapshot.content(), "world state starts with a \
                                                                                            snapshot");
        snapshot.fill(kept, results)
    }

    /// Does the world state belong to these blocks?
    fn check(&self, ledger: &Ledger) -> Result<(), Rejection> {
        let (reached, store) = (ledger.tip(), self.store);
        if reached.height > store.last_index() {
            // Not a doubt about the state: the log has lost blocks that were promised. Rebuilding would hide it.
            return Err(Rejection::new(Code::ChainInvalid, "the log has lost committed blocks")
                .found(format!(
                    "blocks up to height {}, and a world state of a later height {}",
                    store.last_index(),
                    reached.height
                ))
                .wanted(format!("blocks up to height {}", reached.height))
                .next(format!("{REJOIN}: it comes back as a new node and fetches them from the others; without others, restore blocks/ from a copy")));
        }
        if reached.height + 1 < store.first_index() {
            return Err(Rejection::new(Code::Corrupt, "the world state ends before the first stored block").found(
                format!("a world state of height {}, and blocks from {} on", reached.height, store.first_index()),
            ));
        }
        if reached.height > 0 && store.term(reached.height) != Some(reached.term) {
            return Err(Rejection::new(Code::Corrupt, "the world state does not belong to these blocks")
                .found(format!("height {} of term {}", reached.height, reached.term))
                .wanted(format!("term {:?}", store.term(reached.height))));
        }
        Ok(())
    }

    /// The height of the newest certified block, if the log has that block and it is not executed yet. The log does not flush how
    /// far it is committed for its own sake. So after a crash it may not know that of a block that voters have signed; a
    /// leader that liars have elected could replace it then.
    fn certified(&self, ledger: &Ledger) -> Result<u64, Rejection> {
        let tip = ledger.tip();
        let Some((height, block)) = self.certified.filter(|(height, _)| *height > tip.height) else { return Ok(0) };
        let (mut hash, mut time, mut next) = (tip.hash, tip.time, tip.height + 1);
        while next <= height {
            let entries = self.store.entries(next..height + 1, REPLAY_BYTES)?;
            if entries.first().is_none_or(|entry| entry.index != next) || active(Mutation::DropACertifiedBlock) {
                return Ok(0);
            }
            for entry in &entries {
                let header = Header::following(hash, time, entry);
                (hash, time, next) = (header.hash(), header.time, next + 1);
            }
        }
        Ok(if hash == block { height } else { 0 })
    }

    fn execute_the_rest(&self, ledger: &Ledger, kept: &mut impl Kept) -> Result<(), Rejection> {
        let committed = self.store.hard_state().commit.max(self.certified(ledger)?);
        let mut next = ledger.tip().height + 1;
        if active(Mutation::ApplyTwiceAfterASnapshot) && self.store.first_index() > 1 {
            next = (next - 1).max(self.store.first_index());
        }
        while next <= committed {
            for entry in self.store.entries(next..committed + 1, REPLAY_BYTES)? {
                kept.replay(ledger, &entry)?;
                next += 1;
            }
            if ledger.pending_bytes() > DIRTY_BYTES_MAX {
                ledger.flush(Some(self.snapshots))?;
                tracing::info!(height = next - 1, of = committed, "executing blocks again");
            }
        }
        Ok(())
    }
}
