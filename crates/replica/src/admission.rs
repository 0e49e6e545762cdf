//! The treatment of a submitted transaction: a node orders it, answers it, or holds it until the state is current.
//!
//! [`Refusal::step`] says what may be said about one transaction. Here is what a node makes of it.

use crate::reads::Known;
use crate::retries::Retries;
use crate::waiters::{Waiter, Waiters};
use ledger::transaction::Transaction;
use ledger::{Admission, Ground, Ledger, Refusal, Step, TransactionRecord};
use ledger_hash::Hash;
use ledger_rejection::Rejection;

/// The node's circumstances, besides the transaction.
pub struct Admitting<'a, W> {
    /// The ledger.
    pub ledger: &'a Ledger,
    /// Clients that wait.
    pub waiters: &'a Waiters<W>,
    /// Repetitions that are ordered although the state refuses them.
    pub retries: &'a Retries,
    /// The node's clock, microseconds since the UNIX epoch.
    pub clock: u64,
    /// Name of the identity that submits, e.g. `Org1/Salma`.
    pub who: &'a str,
    /// The client says that it gave this transaction to no node before.
    pub first_attempt: bool,
}

/// The decision about a transaction.
#[derive(Debug, PartialEq)]
pub enum Decision {
    /// Give it to the engine; its client waits for the verdict.
    Order {
        /// The transaction.
        transaction: Transaction,
        /// Another copy may be on its way. This one is ordered however long it has waited.
        again: bool,
    },
    /// It was executed before, with this verdict.
    Known(Hash, TransactionRecord),
    /// The state refuses it, and may be old: ask ([`crate::Reads::ask`]), then [`Admitting::look_again`].
    Hold(Transaction, Box<Refusal>),
    /// Answer with the reason, and count the refusal.
    Refuse {
        /// The finding of the node.
        refusal: Box<Refusal>,
        /// The answer to the client.
        reason: Rejection,
    },
}

impl<W: Waiter> Admitting<'_, W> {
    /// Looks at a transaction that has just come.
    pub fn look(&self, transaction: Transaction) -> Decision {
        self.decide(transaction, None)
    }

    /// Looks at a transaction that was held, with the refusal if it was looked at before. `known` is what became of the
    /// question whether the state is current. It is never held twice.
    pub fn look_again(&self, transaction: Transaction, refusal: Option<Box<Refusal>>, known: &Known) -> Decision {
        // Judged by a state that is new enough: it would be judged the same way again.
        let judged = refusal.filter(|refusal| match (refusal.ground, known) {
            (Ground::Judged { height } | Ground::State { height }, Ok(reached)) => height >= *reached,
            _ => true,
        });
        let decision = match judged {
            Some(refusal) => self.conclude(transaction, refusal, Some(known)),
            None => self.decide(transaction, Some(known)),
        };
        match decision {
            Decision::Hold(_, refusal) => Decision::Refuse { reason: refusal.open(), refusal },
            decision => decision,
        }
    }

    fn decide(&self, transaction: Transaction, reached: Option<&Known>) -> Decision {
        if self.waiters.has(&transaction) {
            // It is on its way already. Perhaps it was lost there, so it goes once more.
            return Decision::Order { transaction, again: true };
        }
        match self.ledger.admit_decoded(transaction, self.clock) {
            Ok(Admission::New(transaction)) => Decision::Order { transaction, again: false },
            Ok(Admission::Known(id, record)) => Decision::Known(id, record),
            Err(refusal) => match refusal.transaction.clone() {
                Some(transaction) => self.conclude(transaction, refusal, reached),
                None => Decision::Refuse { reason: answer_to(&refusal, self.first_attempt), refusal },
            },
        }
    }

    /// The decision about a transaction that the state refuses.
    fn conclude(&self, transaction: Transaction, refusal: Box<Refusal>, reached: Option<&Known>) -> Decision {
        match refusal.step(self.first_attempt, reached) {
            Step::Reach => Decision::Hold(transaction, refusal),
            Step::Order if self.retries.allow(self.who, transaction.encoded().len(), self.clock) => {
                Decision::Order { transaction, again: true }
            }
            Step::Order => Decision::Refuse { reason: refusal.open(), refusal },
            Step::Answer(reason) => Decision::Refuse { refusal, reason },
        }
    }
}

/// The answer to a transaction that this node refuses whatever the ledger says.
pub fn answer_to(refusal: &Refusal, first_attempt: bool) -> Rejection {
    match refusal.step(first_attempt, None) {
        Step::Answer(reason) => reason,
        Step::Reach | Step::Order => refusal.open(),
    }
}
