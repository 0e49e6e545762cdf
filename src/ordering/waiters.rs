//! Clients that wait for the verdict on a transaction, and how the answer travels to them.

use crate::process::meters::observe;
use bytes::Bytes;
use ledger::transaction::KnownBlock;
use ledger_api::v1::{SubmitResponse, Verdict};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_replica::gateway::InFlight;
use ledger_replica::{Answer, Executed, Waiter};
use ledger_storage::result::TransactionResult;
use prometheus_client::metrics::histogram::Histogram;
use std::time::Instant;
use tokio::sync::mpsc;
use tonic::Status;

/// The clients that wait, by their transactions.
pub(crate) type Waiters = ledger_replica::Waiters<Client>;

/// Where the answers of a client go.
pub(crate) type Answers = mpsc::UnboundedSender<Result<SubmitResponse, Status>>;

/// Where an answer goes. The place counts the transaction as in flight until it is answered.
pub(crate) struct Client {
    /// The client's stream, or the call that waits for one answer.
    pub answers: Answers,
    /// Bounds how many can wait.
    pub place: InFlight,
    /// When the transaction came.
    pub since: Instant,
    /// Takes down how long the verdict took.
    pub committed: Histogram,
}

impl Waiter for Client {
    fn answer(self, answer: &Answer<'_>) {
        let response = match answer {
            Answer::Executed(verdict) => {
                observe(&self.committed, self.since);
                executed(verdict)
            }
            Answer::Refused { id, reason } => refused(Some(id), reason),
        };
        let _gone = self.answers.send(Ok(response));
    }

    fn name(&self) -> &str {
        self.place.name()
    }

    fn is_gone(&self) -> bool {
        self.answers.is_closed()
    }
}

/// The verdict of an executed transaction.
pub(crate) fn verdict_of(result: &TransactionResult) -> Verdict {
    result.outcome().map_or_else(|rejection| Verdict::from(&rejection), |_| Verdict::default())
}

/// The answer for a transaction that was not ordered.
pub(crate) fn refused(id: Option<&Hash>, rejection: &Rejection) -> SubmitResponse {
    let id = id.map(|id| id.0.to_vec().into()).unwrap_or_default();
    SubmitResponse { id, verdict: Some(rejection.into()), ..SubmitResponse::default() }
}

/// The part of a block's hash by which signers name it.
pub(crate) fn known_hash(hash: &Hash) -> Bytes {
    KnownBlock::prefix(&hash.0).map(|prefix| Bytes::copy_from_slice(&prefix)).unwrap_or_default()
}

/// The answer for a transaction that was executed.
pub(crate) fn executed(verdict: &Executed<'_>) -> SubmitResponse {
    SubmitResponse {
        id: verdict.id.0.to_vec().into(),
        verdict: Some(verdict_of(verdict.result)),
        height: verdict.height,
        index: verdict.index,
        time: verdict.time,
        response: verdict.result.response.clone(),
        block_hash: verdict.block.map(|hash| known_hash(&hash)).unwrap_or_default(),
    }
}
