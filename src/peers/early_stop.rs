//! Calls of which robots hear before they are ordered: emergency stops.
//!
//! A call that was submitted here is told to the readers of this node that asked for such calls, and passed on to all other nodes,
//! which tell theirs. That needs no leader and no majority, and waits for no disk.
//!
//! Each node keeps such a call on its disk, over restarts, until it has a verdict or is over. It gives it to the leader, also if its
//! state would reject it: robots wait for the verdict.

use crate::ordering::Ordering;
use crate::peers::connections::Connections;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_api::v1::OpenStop;
use ledger_base::durable;
use ledger_base::rejection::Rejection;
use ledger_raft::{EARLY_BYTES_MAX, EarlyCall, Input, Lane, PeerMessage};
use ledger_replica::{Early, Foreseen};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Notify, broadcast};
use tokio::time::{MissedTickBehavior, interval};

/// The file in the data directory with the calls that have no verdict yet.
const FILE: &str = "open-stops";
/// How often a node looks for calls to be given to the leader.
const LOOK_EVERY: Duration = Duration::from_millis(250);
/// Calls that wait for a reader; a slower one gets those that are open again.
const WAITING_MAX: usize = 64;

/// Tells of calls before they are ordered.
pub(crate) struct EarlyStops {
    me: u64,
    file: PathBuf,
    ordering: Arc<Ordering>,
    connections: Arc<Connections>,
    calls: Early,
    readers: broadcast::Sender<Arc<Foreseen>>,
    /// Something is to be saved.
    changed: Notify,
}

impl EarlyStops {
    /// With what the data directory keeps. A file that cannot be read is reported, and the node starts without it.
    pub(crate) fn open(me: u64, data: &Path, ordering: &Arc<Ordering>, connections: &Arc<Connections>) -> Self {
        let stops = Self {
            me,
            file: data.join(FILE),
            ordering: Arc::clone(ordering),
            connections: Arc::clone(connections),
            calls: Early::default(),
            readers: broadcast::Sender::new(WAITING_MAX),
            changed: Notify::new(),
        };
        if let Err(reason) = stops.restore() {
            let file = stops.file.display();
            tracing::error!(%file, code = reason.code.name(), %reason, "stops without a verdict are lost: repeat them");
        }
        stops
    }

    fn restore(&self) -> Result<(), Rejection> {
        if !self.file.exists() {
            return Ok(());
        }
        let saved = durable::read(&self.file, Early::SAVED_BYTES_MAX)?;
        self.calls.restore(&self.ordering.storage.ledger, &saved)
    }

    /// Saves calls and gives them to the leader, until the node stops.
    pub(crate) async fn run(self: Arc<Self>) {
        let mut time = interval(LOOK_EVERY);
        time.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                () = self.changed.notified() => {}
                _ = time.tick() => {}
            }
            let leader = self.leader();
            for transaction in self.calls.tend(&self.ordering.storage.ledger, leader, self.ordering.clock.both()) {
                // A node may not have been connected when the call came.
                self.pass_on(&transaction);
                let input = Input::Submit { lane: Lane::Control, transaction };
                if leader.is_some()
                    && let Err(reason) = self.ordering.slot.input(input)
                {
                    tracing::debug!(code = reason.code.name(), %reason, "cannot order a stop now");
                }
            }
            if let Some(saved) = self.calls.changed() {
                let file = self.file.clone();
                let write = move || durable::replace(&file, &saved, durable::SECRET_MODE);
                if let Ok(Err(reason)) = tokio::task::spawn_blocking(write).await {
                    tracing::warn!(code = reason.code.name(), %reason, "cannot store the stops without a verdict");
                }
            }
        }
    }

    /// The leader, if it is reached.
    fn leader(&self) -> Option<u64> {
        let leader = self.ordering.slot.status().and_then(|ordering| ordering.role.leader)?;
        (leader == self.me || self.connections.connected(leader)).then_some(leader)
    }

    /// The announcement of a call that a user of this node has submitted, if it is one to announce. Nothing speaks against it.
    pub(crate) fn foresee(&self, transaction: &Transaction) -> Option<Arc<Foreseen>> {
        self.calls.submitted(&self.ordering.storage.ledger, transaction, self.ordering.clock.both())
    }

    /// Tells the readers of this node, and the other nodes. The call was handed to the orderer before: the question that a robot asks
    /// now shall come after it.
    pub(crate) fn announce(&self, foreseen: Arc<Foreseen>) {
        let transaction = foreseen.transaction.encoded().clone();
        self.tell(foreseen);
        self.pass_on(&transaction);
    }

    fn pass_on(&self, transaction: &Bytes) {
        if transaction.len() <= EARLY_BYTES_MAX {
            let transaction = transaction.clone();
            self.connections.send_to_all(&PeerMessage::Early(EarlyCall { transaction }));
        }
    }

    /// Another node passes on a call that was submitted there. It is not passed on further: every node knows every other one.
    pub(crate) fn passed_on(&self, from: u64, encoded: Bytes) {
        // Whatever is wrong with it, its verdict says so.
        let Ok(transaction) = Transaction::decode(encoded) else { return };
        if let Some(foreseen) =
            self.calls.passed_on(&self.ordering.storage.ledger, from, &transaction, self.ordering.clock.both())
        {
            self.tell(foreseen);
        }
    }

    /// The calls that have no verdict yet, for a reader that begins to listen or has missed some.
    pub(crate) fn open_calls(&self) -> Vec<Arc<Foreseen>> {
        self.calls.open(&self.ordering.storage.ledger, self.ordering.clock.both())
    }

    /// The calls that have no verdict yet, for the status of the node.
    pub(crate) fn status(&self) -> Vec<OpenStop> {
        let robot = |transaction: &Transaction| transaction.body().args.first().cloned().unwrap_or_default();
        let ledger = &self.ordering.storage.ledger;
        let open = self.calls.calls().into_iter().filter(|transaction| !ledger.is_settled(&transaction.call_ref()));
        open.map(|transaction| OpenStop {
            id: Bytes::copy_from_slice(transaction.id().as_ref()),
            robot: String::from_utf8_lossy(&robot(&transaction)).into_owned(),
            by: ledger.creator_name(&transaction.creator()).unwrap_or_default(),
            not_after: transaction.body().not_after,
        })
        .collect()
    }

    /// The calls from now on.
    pub(crate) fn subscribe(&self) -> broadcast::Receiver<Arc<Foreseen>> {
        self.readers.subscribe()
    }

    fn tell(&self, foreseen: Arc<Foreseen>) {
        let _nobody = self.readers.send(foreseen);
        self.changed.notify_one();
    }
}
