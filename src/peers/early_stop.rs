//! Calls of which robots hear before they are ordered: emergency stops.
//!
//! A call that was submitted here is told to the readers of this node that asked for such calls, and passed on to all other nodes,
//! which tell theirs. That needs no leader and no majority, and waits for no disk.

use crate::ordering::Ordering;
use crate::peers::connections::Connections;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_raft::{EARLY_BYTES_MAX, EarlyCall, PeerMessage};
use ledger_replica::Foreseen;
use std::sync::Arc;
use tokio::sync::broadcast;

/// Calls that wait for a reader; one that is slower hears of the stop in its block.
const WAITING_MAX: usize = 64;

/// Tells of calls before they are ordered.
pub(crate) struct EarlyStops {
    ordering: Arc<Ordering>,
    connections: Arc<Connections>,
    calls: ledger_replica::Early,
    readers: broadcast::Sender<Arc<Foreseen>>,
}

impl EarlyStops {
    /// Nobody reads yet.
    pub(crate) fn new(ordering: &Arc<Ordering>, connections: &Arc<Connections>) -> Self {
        Self {
            ordering: Arc::clone(ordering),
            connections: Arc::clone(connections),
            calls: ledger_replica::Early::default(),
            readers: broadcast::Sender::new(WAITING_MAX),
        }
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
        if transaction.len() <= EARLY_BYTES_MAX {
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

    /// The calls from now on.
    pub(crate) fn subscribe(&self) -> broadcast::Receiver<Arc<Foreseen>> {
        self.readers.subscribe()
    }

    fn tell(&self, foreseen: Arc<Foreseen>) {
        let _nobody = self.readers.send(foreseen);
    }
}
