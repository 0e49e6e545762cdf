//! Clients that wait for the verdict on a transaction.

use crate::gateway::Place;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger::{Ledger, Outcome, TransactionRecord};
use ledger_api::v1::{SubmitResponse, Verdict};
use ledger_hash::Hash;
use ledger_raft::Lane;
use ledger_rejection::{Code, Rejection};
use ledger_storage::result::TransactionResult;
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tonic::Status;

/// After this long without a verdict a client is told that the outcome is unknown; it retries with the same id.
const WAIT_MAX: Duration = Duration::from_secs(10);

/// Where an answer goes. The place counts the transaction as in flight until it is answered.
pub(crate) struct Waiter {
    /// The client's stream, or the call that waits for one answer.
    pub answers: mpsc::UnboundedSender<Result<SubmitResponse, Status>>,
    /// Bounds how many can wait.
    pub place: Place,
}

/// Who waits for which transaction.
#[derive(Default)]
pub(crate) struct Waiters {
    table: Mutex<Table>,
}

#[derive(Default)]
struct Table {
    waiting: HashMap<Hash, Waiting>,
    /// Number of the next transaction.
    next: u64,
}

/// Those who wait for one transaction.
struct Waiting {
    /// The order in which transactions came, and in which they are submitted again.
    number: u64,
    lane: Lane,
    encoded: Bytes,
    waiters: Vec<(Instant, Waiter)>,
}

impl Waiters {
    /// Answers `waiter` as soon as the transaction has a verdict.
    pub(crate) fn add(&self, transaction: &Transaction, lane: Lane, waiter: Waiter) {
        let mut table = self.lock();
        let number = table.next;
        table.next += 1;
        let encoded = transaction.encoded();
        let waiting = table.waiting.entry(transaction.id()).or_insert_with(|| Waiting {
            number,
            lane,
            encoded: encoded.clone(),
            waiters: Vec::with_capacity(1),
        });
        waiting.waiters.push((Instant::now(), waiter));
    }

    /// Does somebody wait for exactly these bytes? Then they were admitted, and are on their way.
    pub(crate) fn has(&self, transaction: &Transaction) -> bool {
        self.lock().waiting.get(&transaction.id()).is_some_and(|waiting| waiting.encoded == *transaction.encoded())
    }

    /// Does nobody wait?
    pub(crate) fn is_empty(&self) -> bool {
        self.lock().waiting.is_empty()
    }

    /// Everything that waits, in the order in which it came. Once another node leads, nobody knows what became of it;
    /// ordered a second time it gets the first verdict.
    pub(crate) fn all(&self) -> Vec<(Lane, Bytes)> {
        let mut all: Vec<_> = self
            .lock()
            .waiting
            .values()
            .map(|waiting| (waiting.number, waiting.lane, waiting.encoded.clone()))
            .collect();
        all.sort_unstable_by_key(|(number, ..)| *number);
        all.into_iter().map(|(_, lane, encoded)| (lane, encoded)).collect()
    }

    /// Answers everybody who waits for a transaction of this block.
    ///
    /// Only a verdict that took the id is the transaction's own (see [`TransactionResult::not_after`]). Another one may be
    /// of a copy: of one that was executed before, whose verdict stands; of one that somebody else forged, which says
    /// nothing; or of one that was ordered too early, while another copy may still be executed.
    pub(crate) fn resolve(&self, outcome: &Outcome, ledger: &Ledger) {
        let executed_here = outcome.ids.iter().zip(&outcome.results).zip(&outcome.transactions);
        for (index, ((id, result), bytes)) in (0u32..).zip(executed_here) {
            if result.not_after.is_some() {
                let Some(waiting) = self.take(id) else { continue };
                answer(waiting, &executed(id, outcome.header.height, index, outcome.header.time, result));
                continue;
            }
            let Some(submitted) = self.lock().waiting.get(id).map(|waiting| waiting.encoded.clone()) else { continue };
            let response = match ledger.transaction(id) {
                Ok(Some(record)) => known(id, &record),
                Ok(None) if *bytes != submitted => continue,
                Ok(None) if is_early(result.code()) => {
                    let reason = format!("transaction {id} was ordered too early: {}", result.message);
                    let early = Rejection::new(Code::Timeout, reason);
                    refused(Some(id), &early.next("submit the same transaction again: it is executed once"))
                }
                Ok(None) if result.code() == Code::Expired && !remembers(ledger, &submitted) => {
                    let reason = format!(
                        "the time of transaction {id} has passed, and this node does not have every block that may hold it"
                    );
                    refused(Some(id), &Rejection::new(Code::Timeout, reason).next("ask a node that keeps older blocks"))
                }
                Ok(None) => executed(id, outcome.header.height, index, outcome.header.time, result),
                Err(fault) => refused(Some(id), &fault),
            };
            answer(self.take(id).unwrap_or_default(), &response);
        }
    }

    /// Tells everybody who waits for a transaction that it was not ordered; answers with the first of them.
    pub(crate) fn refuse(&self, id: &Hash, reason: &Rejection) -> Option<String> {
        let waiting = self.take(id).unwrap_or_default();
        let who = waiting.first().map(|(_, waiter)| waiter.place.name().to_owned());
        answer(waiting, &refused(Some(id), reason));
        who
    }

    /// Answers those who have waited too long, and forgets clients that are gone.
    pub(crate) fn sweep(&self) {
        let mut late = Vec::new();
        self.lock().waiting.retain(|id, waiting| {
            let waiters = &mut waiting.waiters;
            waiters.retain(|(_, waiter)| !waiter.answers.is_closed());
            if waiters.iter().any(|(since, _)| since.elapsed() > WAIT_MAX) {
                late.push((*id, std::mem::take(waiters)));
            }
            !waiters.is_empty()
        });
        for (id, waiting) in late {
            let reason = Rejection::new(Code::Timeout, format!("no verdict on transaction {id} within {WAIT_MAX:?}"))
                .next("submit the same transaction again, through this or another node: it is executed once");
            answer(waiting, &refused(Some(&id), &reason));
        }
    }

    fn take(&self, id: &Hash) -> Option<Vec<(Instant, Waiter)>> {
        self.lock().waiting.remove(id).map(|waiting| waiting.waiters)
    }

    fn lock(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Is it a verdict that another copy, ordered later, may not get?
fn is_early(code: Code) -> bool {
    use Code::{CertificateNotYetValid, NotAfterTooFar, UnknownCreator, Untrusted};
    matches!(code, NotAfterTooFar | UnknownCreator | CertificateNotYetValid | Untrusted)
}

/// Would the ledger know of an earlier verdict?
fn remembers(ledger: &Ledger, submitted: &Bytes) -> bool {
    let transaction = Transaction::decode(submitted.clone());
    transaction.is_ok_and(|transaction| ledger.remembers(transaction.body().not_after).unwrap_or(false))
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
