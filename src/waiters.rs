//! Clients that wait for the verdict on a transaction.

use ledger::result::TransactionResult;
use ledger::{Code, Hash, Ledger, Outcome, Rejection, TransactionRecord};
use ledger_api::v1::{SubmitResponse, Verdict};
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tonic::Status;

/// After this long without a verdict a client is told that the outcome is unknown; it retries with the same id.
const WAIT_MAX: Duration = Duration::from_secs(10);

/// Where an answer goes. The permit counts the transaction as in flight until it is answered.
pub(crate) struct Waiter {
    /// The client's stream, or the call that waits for one answer.
    pub answers: mpsc::UnboundedSender<Result<SubmitResponse, Status>>,
    /// Bounds how many can wait.
    pub _permit: OwnedSemaphorePermit,
}

/// Who waits for which transaction.
#[derive(Default)]
pub(crate) struct Waiters {
    waiting: Mutex<HashMap<Hash, Vec<(Instant, Waiter)>>>,
}

impl Waiters {
    /// Answers `waiter` as soon as the transaction has a verdict.
    pub(crate) fn add(&self, id: Hash, waiter: Waiter) {
        self.lock().entry(id).or_default().push((Instant::now(), waiter));
    }

    /// Answers everybody who waits for a transaction of this block.
    pub(crate) fn resolve(&self, outcome: &Outcome, ledger: &Ledger) {
        for ((index, id), result) in (0u32..).zip(&outcome.ids).zip(&outcome.results) {
            let Some(waiting) = self.lock().remove(id) else { continue };
            let response = match result.code() {
                // The first execution's verdict stands.
                Code::Duplicate => match ledger.transaction(id) {
                    Ok(Some(record)) => known(id, &record),
                    Ok(None) => executed(id, outcome.header.height, index, outcome.header.time, result),
                    Err(fault) => refused(Some(id), &fault),
                },
                _ => executed(id, outcome.header.height, index, outcome.header.time, result),
            };
            answer(waiting, &response);
        }
    }

    /// Tells everybody who waits for a transaction that it was not ordered.
    pub(crate) fn refuse(&self, id: &Hash, reason: &Rejection) {
        let waiting = self.lock().remove(id);
        answer(waiting.unwrap_or_default(), &refused(Some(id), reason));
    }

    /// What was on its way to the leader before may be lost: everybody who waits is told to submit again. At once, or what
    /// clients submit next would overtake it.
    pub(crate) fn new_leader(&self) {
        let all = std::mem::take(&mut *self.lock());
        for (id, waiting) in all {
            let reason =
                Rejection::new(Code::Timeout, format!("the leader changed before transaction {id} had a verdict"))
                    .next("submit the same transaction again: it is executed once");
            answer(waiting, &refused(Some(&id), &reason));
        }
    }

    /// Answers those who have waited too long, and forgets clients that are gone.
    pub(crate) fn sweep(&self) {
        let mut late = Vec::new();
        self.lock().retain(|id, waiting| {
            waiting.retain(|(_, waiter)| !waiter.answers.is_closed());
            if waiting.iter().any(|(since, _)| since.elapsed() > WAIT_MAX) {
                late.push((*id, std::mem::take(waiting)));
            }
            !waiting.is_empty()
        });
        for (id, waiting) in late {
            let reason = Rejection::new(Code::Timeout, format!("no verdict on transaction {id} within {WAIT_MAX:?}"))
                .next("submit the same transaction again, through this or another node: it is executed once");
            answer(waiting, &refused(Some(&id), &reason));
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<Hash, Vec<(Instant, Waiter)>>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn answer(waiting: Vec<(Instant, Waiter)>, response: &SubmitResponse) {
    for (_, waiter) in waiting {
        let _gone = waiter.answers.send(Ok(response.clone()));
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

/// The answer for a transaction that was executed before.
pub(crate) fn known(id: &Hash, record: &TransactionRecord) -> SubmitResponse {
    executed(id, record.height, record.index, record.time, &record.result)
}

fn executed(id: &Hash, height: u64, index: u32, time: u64, result: &TransactionResult) -> SubmitResponse {
    SubmitResponse {
        id: id.0.to_vec().into(),
        verdict: Some(verdict_of(result)),
        height,
        index,
        time,
        response: result.response.clone(),
    }
}
