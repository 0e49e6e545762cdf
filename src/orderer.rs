//! The threads that drive the replica: two.
//!
//! The *order* thread owns the replica, which decides ([`ledger_replica`]). It takes what comes in, sends what goes out, and
//! writes the log: while it waits for the disk, what arrives gathers and becomes the next block. The *execute* thread applies
//! committed blocks to the ledger, wakes subscribers and answers clients; a block that is alone is executed by the order
//! thread itself.
//! Nothing else happens between a transaction and its verdict, so that one command costs as few wake-ups of threads as
//! possible.
//!
//! ```text
//! orderer      the threads and the handle to them
//!   seat       where the rest of the node finds the orderer; empty while the node catches up
//!   order      the order thread
//!   inbox      what waits for one of the two threads
//!   execute    execution, on either thread
//!   handover   giving the leadership to another node
//! ```

mod execute;
mod handover;
mod inbox;
mod order;
mod seat;

pub(crate) use execute::Executed;
pub(crate) use seat::Seat;

use crate::awake::Awake;
use crate::blocks::Blocks;
use crate::clock::Clock;
use crate::denials::Denials;
use crate::gateway::Current;
use crate::housekeeping::Bells;
use crate::instance::Fate;
use crate::peers::{Directory, Peers};
use crate::slice::Turns;
use crate::space::Space;
use crate::waiters::{Client, Waiters};
use execute::Execute;
use inbox::Inbox;
use ledger::Ledger;
use ledger_invariant::vital;
use ledger_raft::{Input, RoleChange, Status};
use ledger_replica::catch_up::Behind;
use ledger_replica::space::Wrote;
use ledger_replica::{Executor, Replica};
use ledger_storage::block_store::{BlockStore, StoreError};
use ledger_storage::snapshot::Snapshots;
use order::Order;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use tokio::sync::watch;

/// Inputs from outside that wait for the order thread, which takes them all at once whenever the disk has answered.
const INBOX_MAX: usize = 4096;

/// The parts that the two threads share with the rest of the node.
pub(crate) struct Shared {
    /// The ledger that blocks are applied to.
    pub ledger: Arc<Ledger>,
    /// The log.
    pub store: Arc<BlockStore>,
    /// The world state at some heights.
    pub snapshots: Arc<Snapshots>,
    /// Where executed blocks go.
    pub blocks: Arc<Blocks>,
    /// Clients that wait for a verdict.
    pub waiters: Arc<Waiters>,
    /// The readers that wait until the state is current.
    pub current: Current,
    /// Executes blocks, and tells everybody whom they concern.
    pub executor: Arc<Executor>,
    /// The members of the network.
    pub directory: Arc<Directory>,
    /// The other nodes.
    pub peers: Arc<Peers>,
    /// The node's clock.
    pub clock: Clock,
    /// The engine's report about blocks that it lacks; the conductor acts on it.
    pub behind: watch::Sender<Option<Behind>>,
    /// Ends the node if it cannot go on.
    pub fate: Fate,
    /// The room that the disk still has.
    pub space: Arc<Space>,
    /// Calls that were refused, here also by ordering.
    pub denials: Arc<Denials>,
    /// Keeps the processors awake.
    pub awake: Arc<Awake>,
    /// How long the turns of its threads are.
    pub turns: Turns,
    /// Wakes housekeeping when there is work for it.
    pub bells: Arc<Bells>,
}

impl Shared {
    /// Makes the log durable. A disk without room gets the reserve first.
    ///
    /// # Errors
    /// As [`BlockStore::flush`]; [`StoreError::DiskFull`] if the reserve is used up.
    pub(crate) fn flush(&self) -> Result<(), StoreError> {
        loop {
            let written = self.store.flush().map(drop);
            if !self.space.wrote(Wrote::from(&written)) {
                return written;
            }
        }
    }
}

/// The running threads.
pub(crate) struct Orderer {
    handle: Handle,
    threads: Vec<JoinHandle<()>>,
}

/// Access to a running orderer; cheap to clone.
#[derive(Clone)]
pub(crate) struct Handle {
    inbox: Arc<Inbox<Input>>,
    status: Arc<Mutex<Status>>,
    role: watch::Receiver<RoleChange>,
}

impl Handle {
    /// Hands in an input; false if the node stops or is flooded. Never blocks.
    pub(crate) fn input(&self, input: Input) -> bool {
        self.inbox.try_put(input, INBOX_MAX)
    }

    /// How ordering stands.
    pub(crate) fn status(&self) -> Status {
        self.status.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Orderer {
    /// Starts the threads.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(replica: Replica<Client>, shared: Arc<Shared>) -> io::Result<Self> {
        let (inbox, blocks) = (Arc::new(Inbox::new()), Arc::new(Inbox::new()));
        let first = replica.status();
        let (role, roles) = watch::channel(first.role);
        let status = Arc::new(Mutex::new(first));
        let execute = Execute::new(Arc::clone(&shared));
        let order = Order::new(replica, shared, execute.clone(), &blocks, Arc::clone(&status), role);
        let (inputs, applied) = (Arc::clone(&inbox), Arc::clone(&inbox));
        let threads = vec![
            std::thread::Builder::new()
                .name("execute".into())
                .spawn(move || vital(|| execute.run(&blocks, &applied)))?,
            std::thread::Builder::new().name("order".into()).spawn(move || vital(|| order.run(&inputs)))?,
        ];
        Ok(Self { handle: Handle { inbox, status, role: roles }, threads })
    }

    /// Access to it.
    pub(crate) fn handle(&self) -> &Handle {
        &self.handle
    }

    /// Ends both threads after what they are doing. Everything acknowledged is on disk already.
    pub(crate) fn stop(&mut self) {
        self.handle.inbox.close();
        for thread in self.threads.drain(..) {
            if thread.join().is_err() {
                tracing::error!("a thread of the orderer panicked");
            }
        }
    }
}
