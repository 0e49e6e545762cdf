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
//!   engines    starts an orderer with the parts of the node that it needs
//!   outlet     what ordering hands to other parts of the node
//!   order      the order thread
//!   inbox      what waits for one of the two threads
//!   execute    execution, on either thread
//!   handover   giving the leadership to another node
//! ```

mod engines;
mod execute;
mod handover;
mod inbox;
mod order;
mod outlet;

pub(crate) use execute::Executed;

use crate::ordering::waiters::Client;
pub(crate) use engines::Engines;
use execute::Execute;
use inbox::Inbox;
use ledger_base::invariant::vital;
use ledger_raft::{Input, RoleChange, Status};
use ledger_replica::Replica;
use order::Order;
pub(crate) use outlet::Outlet;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;
use tokio::sync::watch;

/// Inputs from outside that wait for the order thread, which takes them all at once whenever the disk has answered.
const INBOX_MAX: usize = 4096;

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
    role: watch::Receiver<Reign>,
    /// When a transfer was demanded last.
    demanded: Arc<Mutex<Option<Instant>>>,
}

/// The leader, and since when it leads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reign {
    /// The leader.
    pub change: RoleChange,
    /// When this node was told.
    pub since: Instant,
}

impl Reign {
    /// Begins now.
    fn now(change: RoleChange) -> Self {
        Self { change, since: Instant::now() }
    }
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
    fn start(replica: Replica<Client>, engines: &Arc<Engines>) -> io::Result<Self> {
        let (inbox, blocks) = (Arc::new(Inbox::new()), Arc::new(Inbox::new()));
        let first = replica.status();
        let (role, roles) = watch::channel(Reign::now(first.role));
        let status = Arc::new(Mutex::new(first));
        let execute = Execute::new(engines);
        let order = Order::new(replica, engines, execute.clone(), &blocks, Arc::clone(&status), role);
        let (inputs, applied) = (Arc::clone(&inbox), Arc::clone(&inbox));
        let threads = vec![
            std::thread::Builder::new()
                .name("execute".into())
                .spawn(move || vital(|| execute.run(&blocks, &applied)))?,
            std::thread::Builder::new().name("order".into()).spawn(move || vital(|| order.run(&inputs)))?,
        ];
        Ok(Self { handle: Handle { inbox, status, role: roles, demanded: Arc::default() }, threads })
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
                tracing::error!("orderer thread panicked");
            }
        }
    }
}
