//! Starts engines, and ends them when the node lacks blocks that replication does not bring.
//!
//! ```text
//! Looking ──► Fetching, until the ledger knows the node ──► Running ──► Ending ──► Fetching ──► Running …
//!    └────────────────────────────────────────────────────────▲
//! ```
//!
//! Everything that an engine wrote is durable before the next one begins, as that takes everything in the log for durable. With a
//! full disk the node waits for room: nothing of it was acknowledged, and nothing that was acknowledged is lost.

use crate::catch_up::{Behind, Caught, Holding, is_far_behind, is_known};
use crate::replica::FULL_DISK_PAUSE;
use ledger::Ledger;
use ledger_base::invariant;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::block_store::StoreError;
use std::sync::Arc;

/// Pause before an engine starts again that had nothing to fetch: another leader may still have the blocks.
const RETRY_PAUSE: u64 = 500_000;

/// Something that happened.
#[derive(Debug)]
pub enum Happened {
    /// The question of the start is answered as far as it must be: see [`crate::catch_up::Look`].
    Looked(Vec<Holding>),
    /// The engine says that it lacks blocks.
    Behind(Behind),
    /// The engine has ended, and everything that was committed is executed.
    Ended,
    /// The log was flushed, or not.
    Flushed(Result<(), StoreError>),
    /// The outcome of catching up.
    Caught(Caught),
    /// The pause is over.
    Waited,
}

/// The next thing to do; [`Conductor::step`] is told what came of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Start an engine, which runs until it says that it is behind.
    Start,
    /// End the engine. The node fetches blocks afterwards.
    End(Behind),
    /// Flush the log.
    Flush,
    /// Catch up: [`crate::catch_up::CatchUp`].
    CatchUp(Option<Behind>),
    /// Wait so long, microseconds.
    Pause(u64),
    /// The process has to start again, on the snapshot that it took.
    StartAgain,
    /// Nothing: the engine runs, or is about to end.
    Nothing,
}

/// Decides when a node has an engine.
pub struct Conductor {
    id: u64,
    ledger: Arc<Ledger>,
    phase: Phase,
    /// That nobody could help was said.
    helpless: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Looking,
    Fetching(Option<Behind>),
    Running,
    Ending(Behind),
}

impl Conductor {
    /// Of the node with this number.
    pub fn new(id: u64, ledger: Arc<Ledger>) -> Self {
        Self { id, ledger, phase: Phase::Looking, helpless: false }
    }

    /// Takes what happened, and says the next thing to do.
    ///
    /// # Errors
    /// A reason why the node cannot go on: its disk, or that it was removed.
    pub fn step(&mut self, happened: Happened) -> Result<Next, Rejection> {
        Ok(match (self.phase, happened) {
            (Phase::Looking, Happened::Looked(offers)) => {
                match is_far_behind(&self.ledger, &offers) || !is_known(&self.ledger, self.id)? {
                    true => self.fetch(None),
                    false => self.start(),
                }
            }
            (Phase::Running, Happened::Behind(behind)) => {
                self.phase = Phase::Ending(behind);
                Next::End(behind)
            }
            (Phase::Ending(_), Happened::Ended | Happened::Waited) => Next::Flush,
            (Phase::Ending(behind), Happened::Flushed(Ok(()))) => self.fetch(Some(behind)),
            (Phase::Ending(_), Happened::Flushed(Err(StoreError::DiskFull { .. }))) => Next::Pause(FULL_DISK_PAUSE),
            (Phase::Ending(_), Happened::Flushed(Err(fault))) => return Err(fault.into()),
            (Phase::Fetching(_), Happened::Caught(Caught::Snapshot)) => Next::StartAgain,
            (Phase::Fetching(None), Happened::Caught(_)) => match is_known(&self.ledger, self.id)? {
                true => {
                    if std::mem::take(&mut self.helpless) {
                        tracing::warn!("received the current members of the network");
                    }
                    self.start()
                }
                false => {
                    if !std::mem::replace(&mut self.helpless, true) {
                        tracing::warn!("no node reports the current members of the network; retrying");
                    }
                    Next::Pause(RETRY_PAUSE)
                }
            },
            (Phase::Fetching(Some(behind)), Happened::Caught(Caught::Up)) => {
                let (height, first) = (self.ledger.tip().height, behind.first_index);
                invariant!(
                    height + 1 >= first,
                    "an engine that was behind restarts with the fetched blocks",
                    "the ledger is at block {height}, replication begins at {first}"
                );
                if std::mem::take(&mut self.helpless) {
                    tracing::warn!("up to date with the help of another node");
                }
                self.start()
            }
            (Phase::Fetching(Some(behind)), Happened::Caught(Caught::Nothing)) => {
                // Once, not twice a second.
                if !std::mem::replace(&mut self.helpless, true) {
                    let wanted = behind.first_index.saturating_sub(1);
                    tracing::warn!(wanted, "no node could serve the missing blocks; retrying");
                }
                Next::Pause(RETRY_PAUSE)
            }
            (Phase::Fetching(None), Happened::Waited) => self.fetch(None),
            (Phase::Fetching(Some(_)), Happened::Waited) => self.start(),
            // A leader may say more than once that the node is behind.
            (_, Happened::Behind(_)) => Next::Nothing,
            (phase, happened) => {
                return Err(Rejection::new(Code::Internal, format!("{happened:?} cannot happen in {phase:?}")));
            }
        })
    }

    fn start(&mut self) -> Next {
        self.phase = Phase::Running;
        Next::Start
    }

    fn fetch(&mut self, behind: Option<Behind>) -> Next {
        self.phase = Phase::Fetching(behind);
        Next::CatchUp(behind)
    }
}
