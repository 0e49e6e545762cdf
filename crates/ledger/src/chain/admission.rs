//! Admission: is a transaction worth ordering? And if a node would refuse it, what may the node say?
//!
//! A refusal before ordering is a promise: the transaction was not executed, and it never will be. A node can give it
//! only if it knows two things. Its state must be as new as what was committed when the call came; else it refuses what
//! somebody was granted a moment ago. And no other copy of the transaction may be on its way, at a node that stands
//! still, or in a leader's queue; else that copy is executed later. Only the client knows the second, and says so with
//! its first attempt.

use super::Ledger;
use crate::execution::check_network;
use crate::transaction::{NOT_AFTER_AHEAD_MAX, Transaction};
use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use std::sync::{Arc, PoisonError};

use super::TransactionRecord;

/// How often a call is simulated again when blocks are committed while it is.
const SIMULATE_RETRIES: usize = 3;

/// The answer of [`Ledger::admit`].
#[derive(Clone, Debug, PartialEq)]
pub enum Admission {
    /// Worth ordering.
    New(Transaction),
    /// Executed before under this id: this is its verdict.
    Known(Hash, TransactionRecord),
}

/// A transaction that was refused before it was ordered, and whose it was if that is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// The signer, e.g. `Org1/Farhad`; none if the signature was not verified.
    pub who: Option<String>,
    /// The transaction, if the bytes are one.
    pub transaction: Option<Transaction>,
    /// Why.
    pub rejection: Rejection,
    /// The ground of the refusal.
    pub ground: Ground,
}

/// The ground of a refusal, which decides how long it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ground {
    /// The bytes: nobody will ever execute them.
    Bytes,
    /// Blocks that are executed: whatever comes after them, it cannot be executed any more, and it was not.
    Past,
    /// The call, as the state of this height judges it, and who signed it. Ordered it takes its id, and so gets a
    /// verdict that stands.
    Judged {
        /// Of the state.
        height: u64,
    },
    /// The state of this height, which does not accept who signed it, or when. Ordered it would not take its id.
    State {
        /// Of the state.
        height: u64,
    },
    /// This node: its limits, what it has to do, its disk.
    Node,
}

/// The action of a gateway on a transaction that it would refuse.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Give this answer.
    Answer(Rejection),
    /// Reach what was committed when the call came, then [admit](Ledger::admit) it again.
    Reach,
    /// Order it though: another copy may be on its way, and the first one that is executed has the verdict on both.
    Order,
}

impl Refusal {
    /// A refusal by this node, whatever the ledger says.
    pub fn of_node(who: Option<String>, transaction: Option<Transaction>, rejection: Rejection) -> Self {
        // Bytes that are no transaction are that at every node.
        let ground = if transaction.is_some() { Ground::Node } else { Ground::Bytes };
        Self { who, transaction, rejection, ground }
    }

    /// Decides on the action. `first_attempt`: the client says that it gave this transaction to no node before.
    /// `reached` is a height that was committed when the call came or later, with everything before, or why none is
    /// known; nothing, if that was not asked yet.
    pub fn step(&self, first_attempt: bool, reached: Option<&Result<u64, Rejection>>) -> Step {
        let first_attempt = first_attempt || active(Mutation::RefuseARetry);
        let refused = || Step::Answer(self.rejection.clone());
        let height = match self.ground {
            // It says nothing about the transaction, so it promises nothing.
            _ if self.rejection.code.number() >= 4000 => return refused(),
            Ground::Bytes | Ground::Past => return refused(),
            Ground::Node if first_attempt => return refused(),
            Ground::Node => return Step::Answer(self.open()),
            Ground::Judged { height } | Ground::State { height } => height,
        };
        match reached {
            _ if active(Mutation::RefuseOnAnOldState) => {}
            None => return Step::Reach,
            Some(Err(reason)) => return Step::Answer(self.uncertain(reason)),
            // Blocks were committed under every attempt to simulate it: in a moment it may be quieter.
            Some(Ok(reached)) if height < *reached => return Step::Answer(self.open()),
            Some(Ok(_)) => {}
        }
        match self.ground {
            _ if first_attempt => refused(),
            // With its certificate it is the same transaction: this is no end, but says what is missing.
            _ if self.rejection.code == Code::UnknownCreator => refused(),
            Ground::Judged { .. } => Step::Order,
            _ => Step::Answer(self.open()),
        }
    }

    /// The answer where nobody can know yet what becomes of it.
    pub fn open(&self) -> Rejection {
        let id = self.transaction.as_ref().map(Transaction::id).unwrap_or(Hash::ZERO);
        Rejection::new(Code::Timeout, format!("the verdict on transaction {id} is not known yet"))
            .found(format!(
                "this node would reject it ({} {}), but may not be the first node that received it",
                self.rejection.code, self.rejection.message
            ))
            .wanted("first_attempt, if no node has received it before")
            .next("submit the same transaction again: the answer is its verdict, or that it has expired")
    }

    /// The answer where nobody can know whether the state is current.
    fn uncertain(&self, reason: &Rejection) -> Rejection {
        let found = format!(
            "this node would reject it ({} {}), but its state may be stale",
            self.rejection.code, self.rejection.message
        );
        Rejection::new(
            reason.code,
            format!("this node cannot decide now whether to reject the call: {}", reason.message),
        )
        .found(if reason.found.is_empty() { found } else { format!("{found}; {}", reason.found) })
        .wanted(reason.wanted.clone())
        .next("submit the same transaction again in a moment, or through another node")
    }
}

impl Ledger {
    /// Is this transaction worth ordering? Checks all that execution will check, on the committed state, so that what
    /// would be refused costs the others nothing. `now` is the node's clock in microseconds; block time may be behind
    /// it on a quiet network.
    ///
    /// # Errors
    /// The refusal, with the creator's name if it is known. The answer to the client is another question: see
    /// [`Refusal::step`].
    pub fn admit(&self, encoded: Bytes, now: u64) -> Result<Admission, Box<Refusal>> {
        let transaction = Transaction::decode(encoded).map_err(|rejection| {
            Box::new(Refusal { who: None, transaction: None, rejection, ground: Ground::Bytes })
        })?;
        self.admit_decoded(transaction, now)
    }

    /// As [`Ledger::admit`], for who has read the transaction already.
    ///
    /// # Errors
    /// As [`Ledger::admit`].
    pub fn admit_decoded(&self, transaction: Transaction, now: u64) -> Result<Admission, Box<Refusal>> {
        let refuse = |ground, who: Option<&Identity>, rejection| {
            Box::new(Refusal { who: who.map(Identity::id), transaction: Some(transaction.clone()), rejection, ground })
        };
        check_network(&transaction, &self.network).map_err(|rejection| refuse(Ground::Bytes, None, rejection))?;
        let mut retries = 0;
        loop {
            let record = self.executed(&transaction).map_err(|fault| refuse(Ground::Node, None, fault))?;
            if let Some(record) = record {
                return Ok(Admission::Known(transaction.id(), record));
            }
            let tip = self.tip();
            let refused = match self.judge(&transaction, tip.time, now) {
                Ok(()) => return Ok(Admission::New(transaction)),
                Err(refused) => refused,
            };
            let quiet = self.tip().height == tip.height;
            if quiet || retries == SIMULATE_RETRIES {
                // Refused on the state that this very transaction has left? Whoever sees a block's writes finds its ids.
                let record = self.executed(&transaction).map_err(|fault| refuse(Ground::Node, None, fault))?;
                if let Some(record) = record {
                    return Ok(Admission::Known(transaction.id(), record));
                }
                let Judged { who, rejection, basis } = refused;
                // Half of a block may have been seen: that is a judgement on no state.
                let height = if quiet { tip.height } else { 0 };
                let ground = match basis {
                    Basis::Bytes => Ground::Bytes,
                    Basis::Past => Ground::Past,
                    Basis::Call => Ground::Judged { height },
                    Basis::Creator => Ground::State { height },
                };
                return Err(refuse(ground, who.as_deref(), rejection));
            }
            retries += 1;
        }
    }

    /// Everything that execution will check, on the state as it is.
    fn judge(&self, transaction: &Transaction, block_time: u64, now: u64) -> Result<(), Judged> {
        let judged =
            |basis, who: Option<&Arc<Identity>>, rejection| Judged { who: who.map(Arc::clone), rejection, basis };
        let time = now.max(block_time);
        let not_after = transaction.body().not_after;
        let late = match transaction.check_time(time) {
            Err(late) if late.code == Code::Expired => Some(late),
            in_time => {
                in_time.map_err(|early| judged(Basis::Creator, None, early))?;
                None
            }
        };
        if let Some(late) = &late
            && not_after < block_time
        {
            let basis = match self.remembers(not_after) {
                Ok(true) => Basis::Past,
                Ok(false) => Basis::Creator,
                Err(fault) => return Err(judged(Basis::Creator, None, fault)),
            };
            return Err(judged(basis, None, late.clone()));
        }
        // Late by this node's clock only, it may be in time for a block: a block decides.
        if late.is_some() {
            return self.judge_at(transaction, block_time);
        }
        // Refused by this node's clock only: a lease may have ended, or a certificate. A clock that is ahead must not
        // keep its users from what they hold, so a block decides.
        self.judge_at(transaction, time).or_else(|refused| {
            match time > block_time && self.judge_at(transaction, block_time).is_ok() {
                true => Ok(()),
                false => Err(refused),
            }
        })
    }

    /// Everything that does not depend on when the transaction was signed, at a time.
    fn judge_at(&self, transaction: &Transaction, time: u64) -> Result<(), Judged> {
        let (identity, leaf) = self.authenticate(transaction, time)?;
        let body = transaction.body();
        let call = self.call(&identity, time, transaction.id(), &body.chaincode, &body.function, &body.args);
        call.map_err(|rejection| Judged { who: Some(Arc::clone(&identity)), rejection, basis: Basis::Call })?;
        self.verified.insert(leaf);
        self.large.insert(transaction);
        Ok(())
    }

    /// The verified signer of a transaction, and its leaf.
    pub(super) fn authenticate(&self, transaction: &Transaction, time: u64) -> Result<(Arc<Identity>, Hash), Judged> {
        let judged = |basis, rejection| Judged { who: None, rejection, basis };
        let (overlay, leaf) = (self.overlay(), transaction.leaf());
        let (identity, _) = self.identities.creator(transaction, &overlay, time).map_err(|rejection| {
            // A revocation is never taken back.
            judged(if rejection.code == Code::Revoked { Basis::Past } else { Basis::Creator }, rejection)
        })?;
        if !self.verified.contains(&leaf) {
            transaction.verify(&identity.public_key).map_err(|rejection| judged(Basis::Bytes, rejection))?;
        }
        Ok((identity, leaf))
    }

    /// Is every block at hand in which a transaction may have been executed that lived until then? Only then is what is
    /// not found not executed.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn remembers(&self, not_after: u64) -> Result<bool, Rejection> {
        let first = self.results.first();
        if first <= 1 {
            return Ok(true);
        }
        let block = self.block_hashes(first)?;
        Ok(block.is_some_and(|block| block.time < not_after.saturating_sub(NOT_AFTER_AHEAD_MAX)))
    }

    /// Checks the signatures of transactions that are about to be admitted: together they cost a third of what each
    /// costs alone. Only admission tells what is wrong with one.
    pub fn verify_together<'a>(&self, transactions: impl Iterator<Item = &'a Transaction>, now: u64) {
        let leaves = transactions.map(|transaction| (transaction.leaf(), transaction));
        let unverified = leaves.filter(|(leaf, _)| !self.verified.contains(leaf));
        self.identities.verify_together(unverified, now).into_iter().for_each(|leaf| self.verified.insert(leaf));
    }

    /// The same as [`Ledger::transaction`], for who has the transaction: history is only searched for what block time
    /// has passed.
    fn executed(&self, transaction: &Transaction) -> Result<Option<TransactionRecord>, Rejection> {
        let (id, not_after) = (transaction.id(), transaction.body().not_after);
        let time = self.tip().time;
        let recent = {
            let window = self.window.read().unwrap_or_else(PoisonError::into_inner);
            // A block that is being executed may have made the window forget what its time passes.
            window
                .find(&id, not_after)
                .map(Some)
                .or_else(|| (window.covers(not_after) && not_after >= time).then_some(None))
        };
        match recent {
            Some(Some(place)) => self.record(place),
            Some(None) => Ok(None),
            None => self.results.find(&id)?.map_or(Ok(None), |place| self.record(place)),
        }
    }
}

/// A refusal by [`Ledger::judge`].
pub(super) struct Judged {
    who: Option<Arc<Identity>>,
    rejection: Rejection,
    basis: Basis,
}

enum Basis {
    /// As [`Ground::Bytes`].
    Bytes,
    /// As [`Ground::Past`].
    Past,
    /// As [`Ground::Judged`].
    Call,
    /// As [`Ground::State`].
    Creator,
}
