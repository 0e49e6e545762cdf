//! Starts engines, with the parts of the node that they need.

use super::{Orderer, Outlet};
use crate::ordering::directory::Directory;
use crate::ordering::waiters::Waiters;
use crate::process::clock::Clock;
use crate::process::failure::{FailureHandle, thread_error};
use crate::process::idle_control::IdleControl;
use crate::process::scheduler_slices::Turns;
use crate::storage::housekeeping::Bells;
use crate::storage::log::Log;
use ledger_base::rejection::Rejection;
use ledger_raft::Ballots;
use ledger_replica::catch_up::Behind;
use ledger_replica::{Executor, Replica, Settings};
use prometheus_client::metrics::histogram::Histogram;
use std::sync::Arc;
use tokio::sync::watch;

/// Starts one engine after the other. Its threads share it.
pub(crate) struct Engines {
    /// Executes blocks and notifies the observers.
    pub executor: Arc<Executor>,
    /// Signs votes.
    pub ballots: Arc<dyn Ballots>,
    /// Receives what ordering hands to other parts of the node.
    pub outlet: Arc<dyn Outlet>,
    /// Clients that wait for a verdict.
    pub waiters: Arc<Waiters>,
    /// The node's clock.
    pub clock: Clock,
    /// The log.
    pub log: Log,
    /// Wake housekeeping when there is work for it.
    pub bells: Arc<Bells>,
    /// Keeps the processors awake.
    pub idle_control: Arc<IdleControl>,
    /// How long the turns of the threads are.
    pub turns: Turns,
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// The engine's report about blocks that it lacks; the conductor acts on it.
    pub behind: watch::Sender<Option<Behind>>,
    /// Ends the node if it cannot continue.
    pub failure: FailureHandle,
    /// Takes down how long executing takes.
    pub execution: Histogram,
}

impl Engines {
    /// Starts an engine and its threads. Everything in the log must be durable.
    ///
    /// # Errors
    /// As [`Replica::start`]; [`ledger_base::rejection::Code::Internal`] if the operating system gives no thread.
    pub(crate) fn start(self: &Arc<Self>, settings: &Settings) -> Result<Orderer, Rejection> {
        self.behind.send_replace(None);
        let (store, executor, waiters) =
            (Arc::clone(&self.log.store), Arc::clone(&self.executor), Arc::clone(&self.waiters));
        let (desired, ballots) = (self.directory.desired(), Arc::clone(&self.ballots));
        let replica = Replica::start(settings, store, executor, waiters, desired, ballots)?;
        Orderer::start(replica, self).map_err(|error| thread_error(&error))
    }
}
