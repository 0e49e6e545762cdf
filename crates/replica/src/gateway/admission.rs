//! The treatment of a submitted transaction: a node orders it, answers it, or holds it until the state is current.
//!
//! [`Refusal::step`] says what may be said about one transaction. Here is what a node makes of it.

use super::held::Item;
use super::line::{Arrived, overloaded};
use crate::budgets::Budgets;
use crate::reads::Known;
use crate::replica::Now;
use crate::retries::Retries;
use crate::waiters::{Waiter, Waiters};
use ledger::transaction::Transaction;
use ledger::{Admission, Ground, Ledger, Refusal, Step, TransactionRecord};
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_raft::Lane;

/// The node's circumstances, besides the transaction.
pub struct Admitting<'a, C> {
    /// The ledger.
    pub ledger: &'a Ledger,
    /// Clients that wait.
    pub waiters: &'a Waiters<C>,
    /// Repetitions that are ordered although the state refuses them.
    pub retries: &'a Retries,
    /// How much identities, organisations and services have sent.
    pub budgets: &'a Budgets,
    /// Most bytes a second of one organisation, as the disk has room.
    pub organisation_bytes: u64,
    /// The node's clocks.
    pub now: Now,
    /// Longest time that data waits until it is looked at, microseconds.
    pub wait_max: u64,
}

/// The decision about a transaction.
pub enum Decision<C> {
    /// Give it to the engine; its client waits for the verdict.
    Order(Arrived<C>),
    /// It was executed before, with this verdict.
    Known {
        /// The client to be told.
        client: C,
        /// The transaction.
        id: Hash,
        /// The verdict.
        record: TransactionRecord,
    },
    /// The state refuses it, and may be old: ask ([`crate::Reads::ask`]), then [`Admitting::look_again`].
    Hold(Item<C>),
    /// Answer with the reason, and count the refusal.
    Refuse {
        /// The client to be told.
        client: C,
        /// The finding of the node.
        refusal: Box<Refusal>,
        /// The answer to the client.
        reason: Rejection,
    },
}

impl<C: Waiter> Admitting<'_, C> {
    /// Looks at a transaction that has just come.
    pub fn look(&self, arrived: Arrived<C>) -> Decision<C> {
        self.decide(arrived, None)
    }

    /// Looks at a transaction that was held, with the refusal if it was looked at before. `known` is what became of the
    /// question whether the state is current. It is never held twice.
    pub fn look_again(&self, item: Item<C>, known: &Known) -> Decision<C> {
        let Item { arrived, refusal } = item;
        // Judged by a state that is new enough: it would be judged the same way again.
        let judged = refusal.filter(|refusal| match (refusal.ground, known) {
            (Ground::Judged { height } | Ground::State { height }, Ok(reached)) => height >= *reached,
            _ => true,
        });
        let decision = match judged {
            Some(refusal) => self.conclude(arrived, refusal, Some(known)),
            None => self.decide(arrived, Some(known)),
        };
        match decision {
            Decision::Hold(Item { arrived, refusal: Some(refusal) }) => {
                Decision::Refuse { client: arrived.client, reason: refusal.open(), refusal }
            }
            decision => decision,
        }
    }

    /// Data that does not come over a stream is refused if it has waited too long.
    pub fn look_alone(&self, arrived: Arrived<C>) -> Decision<C> {
        match self.waited(&arrived) {
            waited if arrived.ticket.lane == Lane::Data && waited > self.wait_max => self.overdue(arrived, waited),
            _ => self.look(arrived),
        }
    }

    /// A call that this node refuses, whatever the ledger says.
    pub(super) fn refuse(arrived: Arrived<C>, rejection: Rejection) -> Decision<C> {
        let Arrived { transaction, ticket, client } = arrived;
        let refusal = Box::new(Refusal::of_node(Some(client.name().to_owned()), Some(transaction), rejection));
        Decision::Refuse { client, reason: answer_to(&refusal, ticket.first_attempt), refusal }
    }

    fn decide(&self, arrived: Arrived<C>, reached: Option<&Known>) -> Decision<C> {
        let Arrived { transaction, ticket, client } = arrived;
        if self.waiters.has(&transaction) {
            // It is on its way already. Perhaps it was lost there, so it goes once more.
            return Decision::Order(Arrived { transaction, ticket, client });
        }
        match self.ledger.admit_decoded(transaction, self.now.clock) {
            Ok(Admission::New(transaction)) => {
                let arrived = Arrived { transaction, ticket, client };
                let waited = self.waited(&arrived);
                let of_data = ticket.lane == Lane::Data;
                if of_data
                    && let Err(used_up) = self.budgets.admit(
                        self.ledger,
                        &arrived.transaction,
                        (self.now.elapsed, self.now.clock),
                        self.organisation_bytes,
                    )
                {
                    return Self::refuse(arrived, used_up);
                }
                // It waited for the state to be current, while newer data came.
                match reached.is_some() && of_data && waited > self.wait_max * 2 {
                    true => self.overdue(arrived, waited),
                    false => Decision::Order(arrived),
                }
            }
            Ok(Admission::Known(id, record)) => Decision::Known { client, id, record },
            Err(refusal) => match refusal.transaction.clone() {
                Some(transaction) => self.conclude(Arrived { transaction, ticket, client }, refusal, reached),
                None => Decision::Refuse { client, reason: answer_to(&refusal, ticket.first_attempt), refusal },
            },
        }
    }

    /// The decision about a transaction that the state refuses.
    fn conclude(&self, arrived: Arrived<C>, refusal: Box<Refusal>, reached: Option<&Known>) -> Decision<C> {
        let bytes = arrived.transaction.encoded().len();
        match refusal.step(arrived.ticket.first_attempt, reached) {
            Step::Reach => Decision::Hold(Item { arrived, refusal: Some(refusal) }),
            Step::Order if self.retries.allow(arrived.client.name(), bytes, self.now.clock) => Decision::Order(arrived),
            Step::Order => Decision::Refuse { client: arrived.client, reason: refusal.open(), refusal },
            Step::Answer(reason) => Decision::Refuse { client: arrived.client, refusal, reason },
        }
    }

    fn waited(&self, arrived: &Arrived<C>) -> u64 {
        self.now.elapsed.saturating_sub(arrived.ticket.since)
    }

    fn overdue(&self, arrived: Arrived<C>, waited: u64) -> Decision<C> {
        Self::refuse(arrived, overloaded(true, waited, (1, waited), self.wait_max))
    }
}

/// The answer to a transaction that this node refuses whatever the ledger says.
pub(super) fn answer_to(refusal: &Refusal, first_attempt: bool) -> Rejection {
    match refusal.step(first_attempt, None) {
        Step::Answer(reason) => reason,
        Step::Reach | Step::Order => refusal.open(),
    }
}

/// The id of a transaction that is refused, if the bytes are one.
pub fn id_of(refusal: &Refusal) -> Option<Hash> {
    refusal.transaction.as_ref().map(Transaction::id)
}
