//! Starts engines, and ends them when the node lacks blocks that replication does not bring: as
//! [`ledger_replica::conductor`] decides.
//!
//! The orderer tells here that it is behind; then its engine ends, the node catches up, and a new engine goes on from
//! there. Clients are told meanwhile that the node is behind.

use crate::ordering::orderer::Engines;
use crate::peers::sync::BlockSync;
use ledger_base::invariant::vital_task;
use ledger_base::rejection::{Code, Rejection};
use ledger_raft::Secret;
use ledger_replica::catch_up::Behind;
use ledger_replica::conductor::{self, Happened, Next};
use ledger_replica::{Settings, Timing};
use ledger_storage::block_store::StoreError;
use std::sync::Arc;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Keeps an engine running.
pub(crate) struct Conductor {
    id: u64,
    timing: Timing,
    secret: Secret,
    engines: Arc<Engines>,
    sync: BlockSync,
    machine: conductor::Conductor,
    /// The orderer's last report of being behind.
    behind: watch::Receiver<Option<Behind>>,
}

impl Conductor {
    /// For the node with this id, and the secret behind its receipts.
    pub(crate) fn new((id, secret): (u64, Secret), timing: Timing, engines: Arc<Engines>, sync: BlockSync) -> Self {
        let behind = engines.behind.subscribe();
        let machine = conductor::Conductor::new(id, Arc::clone(engines.executor.ledger()));
        Self { id, timing, secret, engines, sync, machine, behind }
    }

    /// Starts the first engine, unless the node is far behind; then goes on in a task of its own until the node stops.
    ///
    /// # Errors
    /// A fault that keeps an engine from starting; a voter that has lost its blocks.
    pub(crate) async fn begin(mut self) -> Result<JoinHandle<()>, Rejection> {
        let (offers, open) = self.sync.look(self.timing.election_time()).await?;
        let mut next = self.machine.step(Happened::Looked(offers))?;
        if next == Next::Start {
            self.start_engine()?;
            next = Next::Nothing;
        }
        let hearing = self.sync.hear_out(open);
        let running = async move {
            let failure = self.engines.failure.clone();
            if let Err(reason) = self.run(next).await {
                failure.fail(reason);
            }
        };
        Ok(tokio::spawn(vital_task(async move {
            tokio::join!(running, hearing);
        })))
    }

    async fn run(mut self, mut next: Next) -> Result<(), Rejection> {
        while !self.sync.is_stopping() {
            let happened = match next {
                Next::Start => {
                    self.start_engine()?;
                    next = Next::Nothing;
                    continue;
                }
                Next::Nothing => match self.hear_of_behind().await {
                    Some(behind) => Happened::Behind(behind),
                    None => return Ok(()),
                },
                Next::End(behind) => {
                    self.end_engine(behind).await?;
                    Happened::Ended
                }
                Next::Flush => Happened::Flushed(self.flush().await?),
                Next::CatchUp(behind) => Happened::Caught(self.sync.run(behind).await?),
                Next::Pause(time) => {
                    self.sync.pause(time).await;
                    Happened::Waited
                }
                Next::StartAgain => {
                    self.engines.failure.start_again();
                    return Ok(());
                }
            };
            next = self.machine.step(happened)?;
        }
        Ok(())
    }

    /// The orderer's next report of being behind; nothing if the node stops.
    async fn hear_of_behind(&mut self) -> Option<Behind> {
        let mut stopping = self.sync.stopping.clone();
        tokio::select! {
            biased;
            _ = stopping.wait_for(|stopping| *stopping) => None,
            behind = self.behind.wait_for(Option::is_some) => behind.ok().and_then(|behind| *behind),
        }
    }

    /// Ends the engine, and waits until what was committed is executed.
    async fn end_engine(&self, behind: Behind) -> Result<(), Rejection> {
        let slot = Arc::clone(&self.sync.ordering.slot);
        let ended = tokio::task::spawn_blocking(move || slot.clear(behind.first_index.saturating_sub(1)));
        ended.await.map_err(|_| Rejection::new(Code::Internal, "a thread panicked while the engine ended"))
    }

    /// Makes the log durable, if there is room.
    async fn flush(&self) -> Result<Result<(), StoreError>, Rejection> {
        let log = self.engines.log.clone();
        let flushed = tokio::task::spawn_blocking(move || log.flush());
        flushed.await.map_err(|_| Rejection::new(Code::Internal, "a thread panicked with the log"))
    }

    fn start_engine(&self) -> Result<(), Rejection> {
        let settings =
            Settings { id: self.id, seed: crate::process::random::number()?, timing: self.timing, secret: self.secret };
        self.sync.ordering.slot.take_in(self.engines.start(&settings)?);
        Ok(())
    }
}
