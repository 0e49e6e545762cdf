//! Starts an orderer, with the parts of the node that it needs: each of its threads takes the few that are its own.

use super::{Orderer, Outlet};
use crate::ordering::directory::Directory;
use crate::ordering::waiters::Waiters;
use crate::process::clock::Clock;
use crate::process::config::Profile;
use crate::process::failure::FailureHandle;
use crate::process::failure::thread_error;
use crate::process::idle_control::IdleControl;
use crate::process::meters::Meters;
use crate::process::scheduler_slices::Turns;
use crate::storage::housekeeping::Bells;
use crate::storage::log::Log;
use ledger_base::rejection::Rejection;
use ledger_raft::Ballots;
use ledger_replica::catch_up::Behind;
use ledger_replica::{Executor, Replica, Settings};
use std::sync::Arc;
use tokio::sync::watch;

/// Starts one engine after the other; cheap to clone.
#[derive(Clone)]
pub(crate) struct Engines {
    /// Executes blocks, and tells everybody whom they concern.
    pub executor: Arc<Executor>,
    /// The node's key for votes.
    pub ballots: Arc<dyn Ballots>,
    /// Clients that wait for a verdict.
    pub waiters: Arc<Waiters>,
    /// The node's clock.
    pub clock: Clock,
    /// The log.
    pub log: Log,
    /// Keeps the machine awake, and lets it sleep.
    pub pace: Pace,
    /// Where ordering sends and tells.
    pub outside: Outside,
    /// How long the steps of a command take.
    pub meters: Meters,
}

/// The parts that keep the machine awake, and let it sleep; cheap to clone.
#[derive(Clone)]
pub(crate) struct Pace {
    /// Keeps the processors awake.
    pub awake: Arc<IdleControl>,
    /// How long the turns of the threads are.
    pub turns: Turns,
    /// Wakes housekeeping when there is work for it.
    pub bells: Arc<Bells>,
}

/// The parts of the node to which ordering sends, and that it tells; cheap to clone.
#[derive(Clone)]
pub(crate) struct Outside {
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// The rest of the node.
    pub outlet: Arc<dyn Outlet>,
    /// The engine's report about blocks that it lacks; the conductor acts on it.
    pub behind: watch::Sender<Option<Behind>>,
    /// Ends the node if it cannot go on.
    pub failure: FailureHandle,
}

impl Engines {
    /// Starts an engine and its threads. Everything in the log must be durable.
    ///
    /// # Errors
    /// As [`Replica::start`]; [`Code::Internal`] if the operating system gives no thread.
    pub(crate) fn start(&self, settings: &Settings) -> Result<Orderer, Rejection> {
        self.outside.behind.send_replace(None);
        let (store, executor, waiters) =
            (Arc::clone(&self.log.store), Arc::clone(&self.executor), Arc::clone(&self.waiters));
        let (desired, ballots) = (self.outside.directory.desired(), Arc::clone(&self.ballots));
        let replica = Replica::start(settings, store, executor, waiters, desired, ballots)?;
        Orderer::start(replica, self).map_err(|error| thread_error(&error))
    }
}

impl Pace {
    /// As the profile wants it.
    ///
    /// # Errors
    /// [`Code::Internal`] if the operating system gives no thread.
    pub(crate) fn of(profile: Profile) -> Result<Self, Rejection> {
        let awake = Arc::new(IdleControl::start(profile).map_err(|error| thread_error(&error))?);
        Ok(Self { awake, turns: Turns::of(profile), bells: Arc::default() })
    }
}
