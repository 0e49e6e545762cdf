//! The future verdict on a transaction.

use super::in_flight::{Patience, Verdict, unknown};
use super::session::Session;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio::sync::{OwnedSemaphorePermit, oneshot};

/// The future verdict on a submitted transaction. It may be dropped: the transaction is on its way.
#[must_use = "the verdict is in it"]
pub struct Pending(Wait);

enum Wait {
    Sent {
        id: Hash,
        verdict: oneshot::Receiver<Verdict>,
        /// The session must not end while somebody waits for it.
        _session: Arc<Session>,
    },
    Refused(Option<Rejection>),
}

impl Pending {
    /// Sends a transaction for which there is room.
    pub(super) fn send(
        session: &Arc<Session>,
        transaction: &Transaction,
        room: OwnedSemaphorePermit,
        patience: Patience,
    ) -> Self {
        let verdict = session.in_flight.add(transaction, room, patience);
        Self(Wait::Sent { id: transaction.id(), verdict, _session: Arc::clone(session) })
    }

    /// The verdict on a transaction that was not sent.
    pub(super) fn refused(refused: Rejection) -> Self {
        Self(Wait::Refused(Some(refused)))
    }
}

impl Future for Pending {
    type Output = Verdict;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Verdict> {
        match &mut self.0 {
            Wait::Sent { id, verdict, .. } => Pin::new(verdict)
                .poll(cx)
                .map(|verdict| verdict.unwrap_or_else(|_| Err(unknown(*id, 1, "the client was closed")))),
            Wait::Refused(refused) => Poll::Ready(Err(refused
                .take()
                .unwrap_or_else(|| Rejection::new(Code::Internal, "a verdict was asked for twice")))),
        }
    }
}
