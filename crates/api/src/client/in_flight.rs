//! Transactions that were given to the client and have no verdict yet.
//!
//! Everything is under one lock that is held for a few instructions. So no transaction falls between a connection that
//! breaks and the next one, which sends all of them again in their order.

use super::Committed;
use super::fresh::Fresh;
use super::last_answers::LastAnswers;
use super::retry::{ATTEMPT_MAX, ELSEWHERE_AFTER, RETRY_AFTER, is_final};
use crate::report::accepted;
use crate::tls::TlsIdentity;
use crate::v1::SubmitResponse;
use bytes::Bytes;
use ledger::transaction::{TRANSACTION_BYTES_MAX, Transaction};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Class, Code, Rejection};
use std::collections::HashMap;
use std::collections::hash_map;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot};

/// Most transactions of one client in flight.
pub const IN_FLIGHT_MAX: usize = 8192;
/// Most bytes of transactions of one client in flight.
pub const IN_FLIGHT_BYTES_MAX: usize = 64 * 1024 * 1024;
/// Room is counted in units of so many bytes; every transaction takes at least its share of [`IN_FLIGHT_MAX`].
const UNIT_BYTES: usize = 1024;
const UNITS: usize = IN_FLIGHT_BYTES_MAX / UNIT_BYTES;
const UNITS_MIN: usize = UNITS / IN_FLIGHT_MAX;
const _: () = assert!(UNITS_MIN > 0 && TRANSACTION_BYTES_MAX + UNIT_BYTES <= IN_FLIGHT_BYTES_MAX);
const _: () = assert!(UNITS <= Semaphore::MAX_PERMITS);

/// Longest call that is given to a node of another organisation, too: nodes let longer ones wait like data.
const ELSEWHERE_BYTES_MAX: usize = 8 * 1024;
/// Most calls that are given to it at once.
const ELSEWHERE_MAX: usize = 16;

pub(super) type Verdict = Result<Committed, Rejection>;
type Outgoing = mpsc::UnboundedSender<Sent>;

/// A transaction on its way to a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Sent {
    /// The signed bytes.
    pub(super) transaction: Bytes,
    /// No node has seen it before, as far as it is not refused for good.
    pub(super) first_attempt: bool,
}

/// The effect of an answer on the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    Nothing,
    /// This node cannot serve now; perhaps another one can.
    Leave,
    /// The node disagrees with the transaction's dates.
    DoubtClock,
}

/// The effect of a full queue of the node on a transaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Patience {
    /// It is sent again until its time is over.
    Call,
    /// It is refused: a newer command is worth more than this one later, and would be overtaken by it.
    Command,
}

/// Waiting transactions of one client.
pub(super) struct InFlight {
    table: Mutex<Table>,
    room: Arc<Semaphore>,
    fresh: Fresh,
    /// The signer.
    identity: TlsIdentity,
    /// The creator whose certificate the ledger is known to have. After a renewal it is another one than ours.
    introduced: Mutex<Option<Hash>>,
    /// How long a transaction is tried.
    patience: Duration,
    /// Is there another node to go to?
    pub(super) several: AtomicBool,
}

#[derive(Default)]
struct Table {
    entries: HashMap<Hash, Entry>,
    /// The open stream to the node, if there is one. Unbounded in form only: what is in it has room in the table.
    outgoing: Option<Outgoing>,
    /// When the last answer came. A node with much to do answers late, but it answers.
    answered: Option<Instant>,
    /// Until when those rest that a node could not take now. New ones rest with them, so that they do not overtake
    /// them: a command that comes after its successor is refused.
    resting: Option<Instant>,
    /// Number of the next entry.
    next: u64,
}

struct Entry {
    /// The order in which transactions were submitted, and so are sent again.
    number: u64,
    encoded: Bytes,
    waiter: oneshot::Sender<Verdict>,
    /// The other submitters of the same transaction.
    others: Vec<oneshot::Sender<Verdict>>,
    deadline: Instant,
    state: State,
    /// How often it was sent.
    attempts: u32,
    patience: Patience,
    /// Has no node got it that has not refused it for good?
    fresh: bool,
    /// Did this client sign it, and nobody send it before?
    signed_here: bool,
    /// Was it sent without any answer? Then it may have been executed, until a node says what became of it.
    uncertain: bool,
    /// The reason of a node that could not take it.
    refused: Option<Rejection>,
    /// Was it also given to a node of another organisation?
    given_elsewhere: bool,
    _room: OwnedSemaphorePermit,
}

#[derive(Clone, Copy)]
enum State {
    /// Until there is a connection.
    Waiting,
    /// Since that moment.
    Sent(Instant),
    /// Until the others that rest are sent again too.
    Resting,
}

impl InFlight {
    pub(super) fn new(identity: TlsIdentity, patience: Duration, several: bool) -> Self {
        Self {
            table: Mutex::default(),
            room: Arc::new(Semaphore::new(UNITS)),
            fresh: Fresh::default(),
            identity,
            introduced: Mutex::default(),
            patience,
            several: AtomicBool::new(several),
        }
    }

    /// Is the ledger known to have this creator's certificate?
    pub(super) fn introduced(&self, creator: &Hash) -> bool {
        self.known().as_ref() == Some(creator)
    }

    fn known(&self) -> MutexGuard<'_, Option<Hash>> {
        self.introduced.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// This client has signed a transaction just now.
    pub(super) fn signed(&self, id: Hash) {
        self.fresh.signed(id);
    }

    /// Room for a transaction; waits for it.
    pub(super) async fn room(&self, transaction: &Transaction) -> Result<OwnedSemaphorePermit, Rejection> {
        Arc::clone(&self.room)
            .acquire_many_owned(units(transaction))
            .await
            .map_err(|_| Rejection::new(Code::ShuttingDown, "the client is closed"))
    }

    /// Room for a transaction, if there is some.
    pub(super) fn room_now(&self, transaction: &Transaction) -> Result<OwnedSemaphorePermit, Rejection> {
        Arc::clone(&self.room).try_acquire_many_owned(units(transaction)).map_err(|_| {
            Rejection::new(Code::Overloaded, "too many transactions wait for their verdict")
                .found(format!("{} waiting", self.lock().entries.len()))
                .wanted(format!("at most {IN_FLIGHT_MAX} transactions with {IN_FLIGHT_BYTES_MAX} bytes"))
                .next("submit less often, or several messages in one transaction")
        })
    }

    /// Takes a transaction in and sends it, now or with the next connection.
    pub(super) fn add(
        &self,
        transaction: &Transaction,
        room: OwnedSemaphorePermit,
        patience: Patience,
    ) -> oneshot::Receiver<Verdict> {
        let (waiter, verdict) = oneshot::channel();
        let fresh = self.fresh.take(&transaction.id());
        let mut table = self.lock();
        let table = &mut *table;
        match table.entries.entry(transaction.id()) {
            hash_map::Entry::Occupied(mut known) => known.get_mut().others.push(waiter),
            hash_map::Entry::Vacant(place) => {
                let now = Instant::now();
                let entry = place.insert(Entry {
                    number: table.next,
                    encoded: transaction.encoded().clone(),
                    waiter,
                    others: Vec::new(),
                    deadline: now + self.patience,
                    state: State::Waiting,
                    attempts: 0,
                    patience,
                    fresh,
                    signed_here: fresh,
                    uncertain: false,
                    refused: None,
                    given_elsewhere: false,
                    _room: room,
                });
                table.next += 1;
                match table.resting {
                    Some(_) => entry.state = State::Resting,
                    None => entry.send(table.outgoing.as_ref(), now),
                }
            }
        }
        verdict
    }

    /// A connection is open: everything that waits goes there, in its order.
    pub(super) fn attach(&self, outgoing: Outgoing) {
        let mut table = self.lock();
        table.outgoing = Some(outgoing);
        table.send(|_| true);
    }

    /// The connection broke: what was sent over it may or may not be executed.
    pub(super) fn detach(&self) {
        let mut table = self.lock();
        table.outgoing = None;
        for entry in table.entries.values_mut() {
            entry.uncertain |= matches!(entry.state, State::Sent(_));
            entry.state = State::Waiting;
        }
    }

    /// Takes an answer and tells those who wait for it, unless it calls for another attempt.
    pub(super) fn answer(&self, answer: SubmitResponse) -> Effect {
        let Some(id) = Hash::from_slice(&answer.id) else {
            let code = answer.verdict.as_ref().map(|verdict| verdict.code);
            tracing::warn!(code, "the node answered without an id");
            return Effect::Nothing;
        };
        let mut table = self.lock();
        let table = &mut *table;
        table.answered = Some(Instant::now());
        let hash_map::Entry::Occupied(mut place) = table.entries.entry(id) else { return Effect::Nothing };
        let entry = place.get_mut();
        let verdict = accepted(answer.verdict.as_ref());
        let mut effect = Effect::Nothing;
        if let Err(refused) = &verdict
            && answer.height == 0
        {
            // A full disk, or a long way behind the others, is one node's trouble.
            let own = self.several.load(Ordering::Relaxed) && matches!(refused.code, Code::DiskFull | Code::Behind);
            // What may have been executed already is asked for until that is known.
            let stale = refused.code == Code::Overloaded && entry.patience == Patience::Command && !entry.uncertain;
            if (own || refused.code.class() == Class::Unreachable) && !stale {
                entry.rest(refused.clone());
                // A queue that is full of data may still take what is urgent.
                if refused.code != Code::Overloaded {
                    table.resting.get_or_insert_with(|| Instant::now() + RETRY_AFTER);
                }
                let elsewhere = own
                    || matches!(
                        refused.code,
                        Code::NoLeader | Code::ShuttingDown | Code::Unreachable | Code::ClockOutOfBounds
                    );
                return if elsewhere { Effect::Leave } else { Effect::Nothing };
            }
            if refused.code == Code::UnknownCreator && self.introduce(entry) {
                // If this was the first attempt, the node has nothing more to do with it.
                entry.fresh = entry.attempts == 1 && entry.signed_here;
                entry.send(table.outgoing.as_ref(), Instant::now());
                return Effect::Nothing;
            }
            if matches!(refused.code, Code::Expired | Code::NotAfterTooFar) {
                effect = Effect::DoubtClock;
            }
        }
        let entry = place.remove();
        let creator = self.identity.own().creator;
        if verdict.is_ok() && !self.introduced(&creator) {
            // A transaction of somebody else says nothing about our certificate.
            let ours = Transaction::decode(entry.encoded.clone()).is_ok_and(|done| done.creator() == creator);
            if ours {
                *self.known() = Some(creator);
            }
        }
        // A refusal that is no end, when nothing more can be tried.
        let open =
            entry.uncertain && answer.height == 0 && verdict.as_ref().is_err_and(|refused| !refused.code.is_final());
        let verdict = match verdict {
            Ok(()) => Ok(Committed {
                id,
                height: answer.height,
                index: answer.index,
                time: answer.time,
                response: answer.response,
                certified: false,
                certificate_due: true,
            }),
            Err(refused) if open => Err(unknown(id, entry.attempts, &refused.message)),
            Err(refused) => Err(refused),
        };
        entry.resolve(&verdict);
        effect
    }

    /// Gives up what is too late and sends again what has rested. True if the node seems to be stuck. `broken` is why
    /// there is no connection, if there is none; if that is final, everything is given up. `answers` are those of nodes that could not
    /// serve: they are a better reason than a broken connection.
    pub(super) fn sweep(&self, now: Instant, broken: Option<&Rejection>, answers: &LastAnswers) -> bool {
        let hopeless = broken.is_some_and(is_final);
        let broken = broken.map(|broken| answers.instead_of(broken.clone(), now));
        let mut table = self.lock();
        let table = &mut *table;
        let silent = table.answered.is_none_or(|answered| answered + ATTEMPT_MAX <= now);
        let mut stuck = false;
        for (id, entry) in table.entries.extract_if(|_, entry| hopeless || entry.deadline <= now) {
            let verdict = Err(entry.give_up(id, broken.as_ref()));
            entry.resolve(&verdict);
        }
        for entry in table.entries.values() {
            if let State::Sent(since) = entry.state {
                stuck |= silent && since + ATTEMPT_MAX <= now;
            }
        }
        if table.resting.is_none_or(|until| until <= now) {
            table.send(|entry| matches!(entry.state, State::Resting));
        }
        stuck
    }

    /// The calls that the node has left without an answer for [`ELSEWHERE_AFTER`]: they are given to a node of another organisation, too,
    /// once. Longer calls than control calls are left out.
    pub(super) fn unanswered(&self, now: Instant) -> Vec<Bytes> {
        let mut table = self.lock();
        let due = table.entries.values_mut().filter(|entry| {
            let waits = matches!(entry.state, State::Sent(since) if since + ELSEWHERE_AFTER <= now);
            let is_small = entry.encoded.len() <= ELSEWHERE_BYTES_MAX;
            waits && !entry.given_elsewhere && entry.patience == Patience::Call && is_small
        });
        let mut due: Vec<_> = due.take(ELSEWHERE_MAX).collect();
        due.sort_by_key(|entry| entry.number);
        due.into_iter()
            .map(|entry| {
                entry.given_elsewhere = true;
                entry.encoded.clone()
            })
            .collect()
    }

    /// Adds our certificate to a transaction of ours that came without. False if that is not what was missing.
    fn introduce(&self, entry: &mut Entry) -> bool {
        *self.known() = None;
        let own = self.identity.own();
        let Ok(transaction) = Transaction::decode(entry.encoded.clone()) else { return false };
        if transaction.certificate().is_some() || transaction.creator() != own.creator {
            return false;
        }
        let Ok(introduced) = transaction.with_certificate(Bytes::copy_from_slice(own.certificate())) else {
            return false;
        };
        entry.encoded = introduced.encoded().clone();
        true
    }

    fn lock(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    /// Sends some of what waits, in its order. Nothing rests any more.
    fn send(&mut self, which: impl Fn(&Entry) -> bool) {
        let mut entries: Vec<_> = self.entries.values_mut().filter(|entry| which(entry)).collect();
        entries.sort_unstable_by_key(|entry| entry.number);
        let now = Instant::now();
        for entry in entries {
            entry.send(self.outgoing.as_ref(), now);
        }
        self.resting = None;
    }
}

impl Entry {
    fn send(&mut self, outgoing: Option<&Outgoing>, now: Instant) {
        let sent = Sent { transaction: self.encoded.clone(), first_attempt: self.fresh };
        if outgoing.is_some_and(|outgoing| outgoing.send(sent).is_ok()) {
            self.fresh = false;
            self.state = State::Sent(now);
            self.attempts += 1;
        } else {
            self.state = State::Waiting;
        }
    }

    /// The node did not take it: again in a moment.
    fn rest(&mut self, refused: Rejection) {
        // The node's own "outcome unknown" means that it did take it.
        self.uncertain |= refused.code == Code::Timeout;
        self.refused = Some(refused);
        self.state = State::Resting;
    }

    fn give_up(&self, id: Hash, broken: Option<&Rejection>) -> Rejection {
        let reason = broken.or(self.refused.as_ref()).cloned();
        if self.uncertain || matches!(self.state, State::Sent(_)) {
            let why = reason.map_or_else(|| "the node did not answer".to_owned(), |reason| in_words(&reason));
            return unknown(id, self.attempts, &why);
        }
        let reason = reason.unwrap_or_else(|| Rejection::new(Code::Unreachable, "no node accepted the transaction"));
        let found = if reason.found.is_empty() { String::new() } else { format!("{}; ", reason.found) };
        reason.found(format!("{found}the id of the transaction is {id}"))
    }

    fn resolve(self, verdict: &Verdict) {
        for waiter in self.others {
            let _gone = waiter.send(verdict.clone());
        }
        let _gone = self.waiter.send(verdict.clone());
    }
}

/// A reason with what was found.
fn in_words(Rejection { message, found, .. }: &Rejection) -> String {
    if found.is_empty() { message.clone() } else { format!("{message} ({found})") }
}

/// The outcome is unknown, and how to learn it.
pub(super) fn unknown(id: Hash, attempts: u32, why: &str) -> Rejection {
    Rejection::new(Code::Timeout, format!("no verdict in time; the outcome is unknown, the id is {id}"))
        .found(format!("sent {attempts} times; {why}"))
        .wanted("a verdict")
        .next(format!("check the outcome before repeating the call: ledgerctl tx {id}"))
}

fn units(transaction: &Transaction) -> u32 {
    let units = UNITS_MIN.max(transaction.encoded().len() / UNIT_BYTES + 1);
    u32::try_from(units).unwrap_or(u32::MAX)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
