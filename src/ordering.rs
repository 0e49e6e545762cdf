//! From a transaction to its verdict: ordering, execution, and the clients and readers that wait for them.
//!
//! | module | content |
//! |---|---|
//! | `orderer` | the two threads that order and execute |
//! | `orderer_slot` | access to the running orderer; empty while the node synchronises |
//! | `directory` | the members of the network, from the ledger |
//! | `waiters`, `reads` | clients that wait for a verdict; readers that wait for a current state |
//! | `node_transactions`, `spoken_rules` | transactions of the node itself; the rules of execution that it speaks |

pub(crate) mod directory;
pub(crate) mod node_transactions;
pub(crate) mod orderer;
pub(crate) mod orderer_slot;
pub(crate) mod reads;
pub(crate) mod spoken_rules;
pub(crate) mod waiters;

use crate::process::clock::{Clock, Machine};
use crate::process::config::Config;
use crate::process::failure::{FailureHandle, thread_error};
use crate::process::idle_control::IdleControl;
use crate::process::meters::Meters;
use crate::process::scheduler_slices::Turns;
use crate::storage::Storage;
use directory::Directory;
use ledger_api::tls::TlsIdentity;
use ledger_base::rejection::Rejection;
use ledger_raft::{Ballots, Role, RoleChange};
use ledger_replica::catch_up::Behind;
use ledger_replica::{Budgets, Executor};
use node_transactions::{Author, Signer};
use orderer::{Engines, Executed, Outlet};
use orderer_slot::OrdererSlot;
use reads::ReadIndex;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use waiters::Waiters;

/// Time for another node to take over the leadership when this one stops.
const HANDOVER_TIME_MAX: Duration = Duration::from_secs(1);
/// Pause between two tries of it.
const HANDOVER_PAUSE: Duration = Duration::from_millis(20);

/// Ordering and execution of a node, whose engine comes and goes.
pub(crate) struct Ordering {
    /// The ledger and its files.
    pub storage: Arc<Storage>,
    /// The node's clock.
    pub clock: Clock,
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// Access to the engine, while there is one.
    pub slot: Arc<OrdererSlot>,
    /// Clients that wait for a verdict.
    pub waiters: Arc<Waiters>,
    /// Readers that wait for a current state.
    pub reads: ReadIndex,
    /// How much identities, organisations and services have sent.
    pub budgets: Arc<Budgets>,
    /// Counts executed transactions.
    pub executed: Arc<Executed>,
    /// How long the steps of a command take.
    pub meters: Meters,
    /// Keeps the processors awake.
    pub idle_control: Arc<IdleControl>,
    /// How long the turns of the threads are.
    pub turns: Turns,
    /// Ends the node if it cannot continue.
    pub failure: FailureHandle,
    /// Blocks that this node lacks and that replication does not bring.
    pub behind: watch::Sender<Option<Behind>>,
}

impl Ordering {
    /// Of this ledger, without an engine yet. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn new(
        config: &Config,
        storage: &Arc<Storage>,
        machine: Machine,
        meters: Meters,
    ) -> Result<Arc<Self>, Rejection> {
        let clock = Clock::of(machine, storage.ledger.tip().time);
        let slot = Arc::new(OrdererSlot::empty());
        let idle_control = IdleControl::start(config.profile).map_err(|error| thread_error(&error))?;
        Ok(Arc::new(Self {
            storage: Arc::clone(storage),
            directory: Arc::new(Directory::read(&storage.ledger)),
            waiters: Arc::default(),
            reads: ReadIndex::new(Arc::clone(&slot), Arc::clone(&storage.blocks), clock.clone()),
            budgets: Arc::default(),
            executed: Arc::default(),
            meters,
            idle_control: Arc::new(idle_control),
            turns: Turns::of(config.profile),
            failure: FailureHandle::new(config),
            behind: watch::Sender::new(None),
            clock,
            slot,
        }))
    }

    /// Starts one engine after the other, with the parts of the node that are built later.
    pub(crate) fn engines(
        &self,
        executor: &Arc<Executor>,
        ballots: Arc<dyn Ballots>,
        outlet: Arc<dyn Outlet>,
    ) -> Arc<Engines> {
        Arc::new(Engines {
            executor: Arc::clone(executor),
            ballots,
            outlet,
            waiters: Arc::clone(&self.waiters),
            clock: self.clock.clone(),
            log: self.storage.log.clone(),
            bells: Arc::clone(&self.storage.bells),
            idle_control: Arc::clone(&self.idle_control),
            turns: self.turns,
            directory: Arc::clone(&self.directory),
            behind: self.behind.clone(),
            failure: self.failure.clone(),
            execution: self.meters.execute.clone(),
        })
    }

    /// Submits transactions of the node itself, signed as this identity.
    pub(crate) fn author(&self, identity: &TlsIdentity) -> Arc<Author> {
        let signer = Signer::new(identity.clone(), self.storage.ledger.network(), self.clock.clone());
        Arc::new(Author { signer, storage: Arc::clone(&self.storage), slot: Arc::clone(&self.slot) })
    }

    /// A node that stops and leads hands over first, so that the others need not wait until they miss it. Calls that
    /// are under way go to the next leader.
    pub(crate) async fn hand_over(&self) {
        let Ok(orderer) = self.slot.handle() else { return };
        let deadline = Instant::now() + HANDOVER_TIME_MAX;
        loop {
            let status = orderer.status();
            if status.role.role != Role::Leader || status.membership.voters.len() < 2 {
                return;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            match orderer.transfer(0, left).await {
                Ok(RoleChange { leader, .. }) => {
                    let leader = leader.map(|leader| self.directory.name(leader));
                    return tracing::info!(leader, "leadership transferred");
                }
                Err(reason) if deadline <= Instant::now() + HANDOVER_PAUSE => {
                    return tracing::warn!(code = reason.code.name(), %reason, "leadership transfer failed; the voters \
                                                                               elect a leader");
                }
                // Perhaps the others have just come back, and are heard of in a moment.
                Err(_) => tokio::time::sleep(HANDOVER_PAUSE).await,
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
