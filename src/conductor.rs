//! Starts engines, and ends them when the node lacks blocks that replication does not bring.
//!
//! The orderer tells here that it is behind; then its engine ends, the node catches up, and a new engine goes on from
//! there. Clients are told meanwhile that the node is behind.

use crate::catch_up::{Behind, CatchUp, Caught, Look};
use crate::config::Order;
use crate::instance::count;
use crate::orderer::Orderer;
use ledger_rejection::{Code, Rejection};
use ledger_replica::{Replica, Settings};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Pause before an engine starts again that had nothing to fetch: another leader may still have the blocks.
const RETRY_PAUSE: Duration = Duration::from_millis(500);

/// Keeps an engine running.
pub(crate) struct Conductor {
    id: u64,
    order: Order,
    catch_up: CatchUp,
    /// The orderer's last report of being behind.
    behind: watch::Receiver<Option<Behind>>,
}

impl Conductor {
    /// For the node with this id.
    pub(crate) fn new(id: u64, order: Order, catch_up: CatchUp) -> Self {
        let behind = catch_up.shared.behind.subscribe();
        Self { id, order, catch_up, behind }
    }

    /// Starts the first engine, unless the node is far behind; then goes on in a task of its own until the node stops.
    ///
    /// # Errors
    /// A fault that keeps an engine from starting; a voter that has lost its blocks.
    pub(crate) async fn begin(self) -> Result<JoinHandle<()>, Rejection> {
        let Order { tick_ms, election_ticks, .. } = self.order;
        let Look { offers, open } =
            self.catch_up.look(Duration::from_millis(tick_ms.saturating_mul(election_ticks))).await?;
        let far_behind = self.catch_up.is_far_behind(&offers) || !self.catch_up.is_known()?;
        if !far_behind {
            self.start_engine()?;
        }
        let hearing = self.catch_up.hear_out(open);
        let running = async move {
            let fate = self.catch_up.shared.fate.clone();
            if let Err(reason) = self.run(far_behind).await {
                fate.fail(reason);
            }
        };
        Ok(tokio::spawn(async move {
            tokio::join!(running, hearing);
        }))
    }

    async fn run(mut self, mut far_behind: bool) -> Result<(), Rejection> {
        let mut stopping = self.catch_up.stopping.clone();
        let (mut told, mut helpless) = (false, false);
        loop {
            if far_behind {
                if self.catch_up.run(None).await? == Caught::Snapshot {
                    self.catch_up.shared.fate.start_again();
                    return Ok(());
                }
                if self.catch_up.is_known()? {
                    if told {
                        tracing::warn!("this node has learnt the current members of the network");
                    }
                    self.start_engine()?;
                    far_behind = false;
                } else if !std::mem::replace(&mut told, true) {
                    tracing::warn!("no node tells the current members of the network; asking again");
                } else if tokio::time::timeout(RETRY_PAUSE, stopping.wait_for(|stopping| *stopping)).await.is_ok() {
                    return Ok(());
                }
                continue;
            }
            let behind = tokio::select! {
                biased;
                _ = stopping.wait_for(|stopping| *stopping) => return Ok(()),
                behind = self.behind.wait_for(Option::is_some) => match behind {
                    Ok(behind) => *behind,
                    Err(_) => return Ok(()),
                },
            };
            let Some(behind) = behind else { continue };
            self.end_engine(behind).await?;
            match self.catch_up.run(Some(behind)).await? {
                Caught::Up => {
                    if std::mem::take(&mut helpless) {
                        tracing::warn!("another node has helped this node to catch up");
                    }
                }
                Caught::Snapshot => {
                    self.catch_up.shared.fate.start_again();
                    return Ok(());
                }
                Caught::Nothing => {
                    // Once, not twice a second.
                    if !std::mem::replace(&mut helpless, true) {
                        tracing::warn!(
                            wanted = behind.first_index - 1,
                            "no node could help this node to catch up; trying again"
                        );
                    }
                    let _stopping = tokio::time::timeout(RETRY_PAUSE, stopping.wait_for(|stopping| *stopping)).await;
                }
            }
            self.catch_up.shared.behind.send_replace(None);
            self.start_engine()?;
        }
    }

    /// Ends the engine. Its writes are durable afterwards, as the next one takes everything in the log for durable.
    async fn end_engine(&self, behind: Behind) -> Result<(), Rejection> {
        let shared = Arc::clone(&self.catch_up.shared);
        let seat = Arc::clone(&self.catch_up.seat);
        let ended = tokio::task::spawn_blocking(move || {
            seat.clear(behind.first_index.saturating_sub(1));
            shared.store.flush()
        });
        ended.await.map_err(|_| Rejection::new(Code::Internal, "a thread panicked while the engine ended"))??;
        Ok(())
    }

    fn start_engine(&self) -> Result<(), Rejection> {
        let shared = &self.catch_up.shared;
        let Order { tick_ms, election_ticks, wait_ms, .. } = self.order;
        let settings = Settings {
            id: self.id,
            seed: crate::random::number()?,
            tick: tick_ms.saturating_mul(1000),
            election_ticks: count(election_ticks),
            data_wait: wait_ms.saturating_mul(1000),
        };
        let (store, executor, waiters) =
            (Arc::clone(&shared.store), Arc::clone(&shared.executor), Arc::clone(&shared.waiters));
        let replica = Replica::start(&settings, store, executor, waiters, shared.directory.desired())?;
        let orderer = Orderer::start(replica, Arc::clone(shared))
            .map_err(|error| Rejection::new(Code::Internal, format!("cannot start a thread: {error}")))?;
        self.catch_up.seat.take_in(orderer);
        Ok(())
    }
}
