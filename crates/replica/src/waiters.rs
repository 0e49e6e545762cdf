//! Clients that wait for the verdict on a transaction.

use crate::executor::Observer;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger::{Ledger, Outcome, TransactionRecord};
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_base::{costly_invariant, invariant};
use ledger_raft::Lane;
use ledger_storage::result::TransactionResult;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// After this time without a verdict a client is told that the outcome is unknown, microseconds. It retries with the same
/// id.
pub const WAIT_MAX: u64 = 10_000_000;

/// Somebody who waits for the verdict on a transaction.
pub trait Waiter {
    /// Takes the answer. It may be that nobody listens any more.
    fn answer(self, answer: &Answer<'_>);

    /// The name of the identity that submitted the transaction here, e.g. `Org1/Salma`.
    fn name(&self) -> &str;

    /// Has the client gone away?
    fn is_gone(&self) -> bool;
}

/// The answer to a client about its transaction.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer<'a> {
    /// It was executed.
    Executed(Executed<'a>),
    /// It was not ordered, or nobody knows what became of it.
    Refused {
        /// The transaction.
        id: Hash,
        /// Why.
        reason: &'a Rejection,
    },
}

/// The one verdict on a transaction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Executed<'a> {
    /// The transaction.
    pub id: Hash,
    /// Height of its block.
    pub height: u64,
    /// Position in the block.
    pub index: u32,
    /// Block time, microseconds since the UNIX epoch.
    pub time: u64,
    /// The hash of its block, if it was executed just now.
    pub block: Option<Hash>,
    /// The verdict.
    pub result: &'a TransactionResult,
}

impl<'a> Executed<'a> {
    /// The verdict on a transaction that was executed before.
    pub fn recorded(id: Hash, record: &'a TransactionRecord) -> Self {
        let TransactionRecord { height, index, time, result } = record;
        Self { id, height: *height, index: *index, time: *time, block: None, result }
    }

    fn in_block(id: Hash, outcome: &Outcome, index: u32, result: &'a TransactionResult) -> Self {
        let (height, time) = (outcome.header.height, outcome.header.time);
        Self { id, height, index, time, block: Some(outcome.hash), result }
    }
}

/// The clients that wait, by their transactions. All times are in microseconds of one clock that does not go back.
pub struct Waiters<W> {
    table: Mutex<Table<W>>,
}

struct Table<W> {
    waiting: HashMap<Hash, Waiting<W>>,
    /// Number of the next transaction.
    next: u64,
}

/// Those who wait for one transaction; never nobody.
struct Waiting<W> {
    /// The order in which transactions came, and in which they are submitted again.
    number: u64,
    lane: Lane,
    encoded: Bytes,
    waiters: Vec<(u64, W)>,
}

impl<W> Default for Waiters<W> {
    fn default() -> Self {
        Self { table: Mutex::new(Table { waiting: HashMap::new(), next: 0 }) }
    }
}

impl<W: Waiter> Waiters<W> {
    /// Answers `waiter`, which comes at a time, as soon as the transaction has a verdict.
    pub fn add(&self, now: u64, transaction: &Transaction, lane: Lane, waiter: W) {
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
        let before = waiting.number;
        invariant!(before <= number, "numbers of waiting transactions grow", "{number} after {before}");
        waiting.waiters.push((now, waiter));
    }

    /// Does somebody wait for exactly these bytes? Then they were admitted, and are on their way.
    pub fn has(&self, transaction: &Transaction) -> bool {
        self.lock().waiting.get(&transaction.id()).is_some_and(|waiting| waiting.encoded == *transaction.encoded())
    }

    /// Does nobody wait?
    pub fn is_empty(&self) -> bool {
        self.lock().waiting.is_empty()
    }

    /// Everything that waits, in the order in which it came. Once another node leads, nobody knows what became of it;
    /// ordered a second time it gets the first verdict.
    pub fn all(&self) -> Vec<(Lane, Bytes)> {
        let mut table = self.lock();
        if active(Mutation::ForgetAWaiter) {
            table.waiting.clear();
        }
        let waiting = table.waiting.values();
        let mut all: Vec<_> = waiting.map(|waiting| (waiting.number, waiting.lane, waiting.encoded.clone())).collect();
        drop(table);
        all.sort_unstable_by_key(|(number, ..)| *number);
        costly_invariant!(
            all.is_sorted_by(|(one, ..), (next, ..)| one < next),
            "each number is given to one waiting transaction",
            "{:?}",
            all.iter().map(|(number, ..)| number).collect::<Vec<_>>()
        );
        all.into_iter().map(|(_, lane, encoded)| (lane, encoded)).collect()
    }

    /// Answers everybody who waits for a transaction of this block.
    ///
    /// Only a verdict that took the id is the transaction's own (see [`TransactionResult::not_after`]). Another one may
    /// be of a copy. The copy was executed before, and its verdict stands; or somebody else forged it, which says
    /// nothing; or it was ordered too early, while another copy may still be executed.
    pub fn resolve(&self, outcome: &Outcome, ledger: &Ledger) {
        let (transactions, results) = (outcome.transactions.len(), outcome.results.len());
        invariant!(
            outcome.ids.len() == transactions && results == transactions,
            "each transaction of a block has one id and one verdict",
            "block {} with {transactions} transactions, {} ids and {results} verdicts",
            outcome.header.height,
            outcome.ids.len()
        );
        let executed_here = outcome.ids.iter().zip(&outcome.results).zip(&outcome.transactions);
        for (index, ((id, result), bytes)) in (0u32..).zip(executed_here) {
            let executed = || Answer::Executed(Executed::in_block(*id, outcome, index, result));
            if result.not_after.is_some() || active(Mutation::AnswerWithAForgedCopy) {
                answer(self.take(id), &executed());
                continue;
            }
            let Some(submitted) = self.lock().waiting.get(id).map(|waiting| waiting.encoded.clone()) else { continue };
            let refused = |reason: &Rejection| answer(self.take(id), &Answer::Refused { id: *id, reason });
            match ledger.transaction(id) {
                Ok(Some(record)) => answer(self.take(id), &Answer::Executed(Executed::recorded(*id, &record))),
                Ok(None) if *bytes != submitted => {}
                Ok(None) if is_early(result.code()) => {
                    let reason = format!("transaction {id} was ordered too early: {}", result.message);
                    refused(&Rejection::new(Code::Timeout, reason));
                }
                Ok(None) if result.code() == Code::Expired && !remembers(ledger, &submitted) => {
                    let reason = format!(
                        "transaction {id} has expired, and this node does not have all blocks that may contain it"
                    );
                    refused(&Rejection::new(Code::Timeout, reason).next("ask a node with a longer retention"));
                }
                Ok(None) => answer(self.take(id), &executed()),
                Err(fault) => refused(&fault),
            }
        }
    }

    /// Tells everybody who waits for a transaction that it was not ordered; answers with the first of them.
    pub fn refuse(&self, id: &Hash, reason: &Rejection) -> Option<String> {
        let waiting = self.take(id);
        let who = waiting.first().map(|(_, waiter)| waiter.name().to_owned());
        answer(waiting, &Answer::Refused { id: *id, reason });
        who
    }

    /// Answers those who have waited too long at this time, and forgets clients that are gone.
    pub fn sweep(&self, now: u64) {
        let mut late = Vec::new();
        self.lock().waiting.retain(|id, waiting| {
            let waiters = &mut waiting.waiters;
            waiters.retain(|(_, waiter)| !waiter.is_gone());
            let late_since = |since: u64| now.saturating_sub(since) > WAIT_MAX && !active(Mutation::ForgetADeadline);
            if waiters.iter().any(|(since, _)| late_since(*since)) {
                late.push((waiting.number, *id, std::mem::take(waiters)));
            }
            !waiters.is_empty()
        });
        late.sort_unstable_by_key(|(number, ..)| *number);
        for (_, id, waiting) in late {
            let reason = format!("no verdict on transaction {id} within {} s", WAIT_MAX / 1_000_000);
            let reason = Rejection::new(Code::Timeout, reason);
            answer(waiting, &Answer::Refused { id, reason: &reason });
        }
    }

    fn take(&self, id: &Hash) -> Vec<(u64, W)> {
        let Some(waiting) = self.lock().waiting.remove(id) else { return Vec::new() };
        invariant!(!waiting.waiters.is_empty(), "somebody waits for what is waited for", "nobody for {id}");
        waiting.waiters
    }

    fn lock(&self) -> MutexGuard<'_, Table<W>> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<W: Waiter + Send> Observer for Waiters<W> {
    fn executed(&self, outcome: &Arc<Outcome>, ledger: &Ledger) {
        self.resolve(outcome, ledger);
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

fn answer<W: Waiter>(waiting: Vec<(u64, W)>, answer: &Answer<'_>) {
    for (_, waiter) in waiting {
        waiter.answer(answer);
    }
}
