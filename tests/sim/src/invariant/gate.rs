//! No gate passes what the certified state does not allow (docs/security.md). The transaction is signed by somebody who held the
//! service with that epoch and was not revoked. An answer of the voters counts for so long after that, and no longer. Each message
//! passes once, in order, and not too long after its signature. A robot that moves is driven by somebody who might, or goes on
//! under a grant that follows theirs.
//!
//! A robot that was notified of a signed stop takes no command until that stop has a verdict or is over. A stop that was executed stops
//! every gate for which the answer of before counts no longer, until the robot is resumed.
//!
//! Told by the events of the blocks, whatever nodes tell the robot.

use super::{Check, Executed, Violation};
use crate::lists;
use crate::people::{People, Person};
use bytes::Bytes;
use ledger::CallRef;
use ledger::transaction::Transaction;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_gate::gate::{COMMAND_TTL, Refused};
use serde::Deserialize;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

const NAME: &str = "gate";
/// How long a service takes messages from their signature, microseconds: the default of the ledger.
const MAX_AGE: u64 = 1_000_000;
/// So much older may a message seem that nothing has delayed, microseconds: a sign of life, and the way of a question and of the news.
const ALLOWANCE: u64 = 500_000;
/// The most by which the clocks of two machines differ that no fault has set, microseconds.
const CLOCKS_APART: u64 = 400_000;
/// The most that rounding may take, microseconds.
const SLACK: u64 = 2_000;

/// From when until when something held, by virtual time.
type Span = (u64, Option<u64>);

/// See the module.
pub struct GateKeepsTheRules {
    people: Arc<People>,
    /// How long an answer of the voters counts, microseconds.
    stale_after: u64,
    /// By service, holder, epoch.
    grants: BTreeMap<(String, String, u64), Span>,
    /// Holder and epoch of the grant that follows another one without a stop, by service and epoch of that one.
    follows: BTreeMap<(String, u64), (String, u64)>,
    /// When each service was for everybody.
    open: BTreeMap<String, Vec<Span>>,
    /// When certificates were revoked.
    revoked: BTreeMap<(String, String), u64>,
    /// In which opening of a bridge a message passed, and what its wall clock said.
    passed: BTreeMap<Hash, (u64, u64)>,
    /// The last number by opening, service, publisher and epoch.
    reached: BTreeMap<(u64, String, String, u64), u64>,
    /// When messages were signed, by virtual time.
    signed: BTreeMap<Hash, u64>,
    /// The driver of each service: the certificate, and the epoch.
    drivers: BTreeMap<String, (Hash, u64)>,
    /// Since when robots are stopped.
    stopped: BTreeMap<String, u64>,
    /// The stops of which the bridge was notified, in which opening, and that have no verdict.
    open_stops: BTreeMap<CallRef, u64>,
    /// Stops that were executed.
    verdicts: BTreeSet<Hash>,
    /// The newest block time.
    time: u64,
}

/// A message that passed.
#[derive(Clone, Copy, Debug)]
pub struct Passed<'a> {
    /// How often the bridge was started.
    pub opening: u64,
    /// The service.
    pub service: &'a str,
    /// The transaction.
    pub transaction: &'a Transaction,
    /// Virtual time.
    pub now: u64,
    /// The robot's wall clock.
    pub wall: u64,
    /// Does the gate measure its age by the block that it names?
    pub by_block: bool,
}

#[derive(Deserialize)]
struct Granted {
    service: String,
    holder: String,
    epoch: u64,
    #[serde(default)]
    follows: Option<u64>,
}

#[derive(Deserialize)]
struct Robot {
    name: String,
    services: Vec<Service>,
}

#[derive(Deserialize)]
struct Service {
    topic: String,
    mode: String,
}

#[derive(Deserialize)]
struct Configured {
    mode: String,
    sharing: Map<String, Value>,
}

impl GateKeepsTheRules {
    /// For these people, and robots for which an answer counts so long.
    pub fn new(people: Arc<People>, stale_after: u64) -> Self {
        Self {
            people,
            stale_after,
            grants: BTreeMap::new(),
            follows: BTreeMap::new(),
            open: BTreeMap::new(),
            revoked: BTreeMap::new(),
            passed: BTreeMap::new(),
            reached: BTreeMap::new(),
            signed: BTreeMap::new(),
            drivers: BTreeMap::new(),
            stopped: BTreeMap::new(),
            open_stops: BTreeMap::new(),
            verdicts: BTreeSet::new(),
            time: 0,
        }
    }

    /// A block was executed for the first time.
    pub fn executed(&mut self, executed: &Executed<'_>, now: u64) {
        self.time = executed.outcome.header.time;
        let calls = executed.transactions.iter().flatten().filter(|call| call.body().function == "stop");
        self.verdicts.extend(calls.map(Transaction::id));
        for emitted in &executed.outcome.events {
            let event = &emitted.event;
            match (&*event.chaincode, &*event.name) {
                ("abac", "stopped") => drop(self.stopped.entry(event.subject.clone()).or_insert(now)),
                ("abac", "resumed") => drop(self.stopped.remove(&event.subject)),
                _ => {}
            }
            if event.chaincode != "abac" || !matches!(&*event.name, "granted" | "released") {
                continue;
            }
            let Granted { service, holder, epoch, follows } = serde_json::from_slice(&event.payload).unwrap();
            if let Some(before) = follows {
                self.follows.insert((service.clone(), before), (holder.clone(), epoch));
            }
            let grant = self.grants.entry((service, holder, epoch)).or_insert((now, None));
            grant.1 = (event.name == "released").then_some(now);
        }
        for (transaction, result) in executed.transactions.iter().zip(&executed.outcome.results) {
            let Some(body) = transaction.as_ref().filter(|_| result.code() == Code::Ok).map(Transaction::body) else {
                continue;
            };
            let text = |at: usize| body.args.get(at).map(|text| String::from_utf8_lossy(text).to_ascii_lowercase());
            match (&*body.chaincode, &*body.function) {
                ("msp", "revoke") => {
                    let key = (text(0).unwrap_or_default(), text(1).unwrap_or_default());
                    self.revoked.entry(key).or_insert(now);
                }
                ("msp", _) => lists::listed(body).into_iter().for_each(|listed| {
                    self.revoked.entry(listed).or_insert(now);
                }),
                ("abac", "configure") => self.configured(&body.args, now),
                ("abac", "replace") => body.args.iter().for_each(|robot| self.described(robot, now)),
                _ => {}
            }
        }
    }

    /// The bridge was notified of these stops.
    pub fn notified(&mut self, opening: u64, stops: impl Iterator<Item = CallRef>) {
        self.open_stops.extend(stops.map(|stop| (stop, opening)));
    }

    /// Why no command of this robot may pass now, if a stop forbids it.
    fn is_stopped(&mut self, robot: &str, opening: u64, now: u64) -> Option<String> {
        let (verdicts, time) = (&self.verdicts, self.time);
        self.open_stops.retain(|stop, _| stop.not_after >= time && !verdicts.contains(&stop.id));
        let open = self.open_stops.iter().find(|(_, notified)| **notified == opening);
        let since = self.stopped.get(robot).filter(|since| **since + self.stale_after + SLACK < now);
        open.map(|(stop, _)| format!("the stop {stop} has no verdict"))
            .or_else(|| since.map(|since| format!("it is stopped since {since}")))
    }

    fn described(&mut self, robot: &[u8], now: u64) {
        let Robot { name, services } = serde_json::from_slice(robot).unwrap();
        for Service { topic, mode } in services {
            self.opens(format!("{name}{topic}"), mode == "open", now);
        }
    }

    /// The owner has chosen who wins. Where only readers are limited, everybody may publish.
    fn configured(&mut self, args: &[Bytes], now: u64) {
        let [service, settings] = args else { return };
        let Configured { mode, sharing } = serde_json::from_slice(settings).unwrap();
        let opens = mode == "open" || mode == "limited" && !sharing.contains_key("publishers");
        self.opens(String::from_utf8_lossy(service).into_owned(), opens, now);
    }

    fn opens(&mut self, service: String, opens: bool, now: u64) {
        let spans = self.open.entry(service).or_default();
        let is_open = spans.last().is_some_and(|(_, until)| until.is_none());
        match (opens, spans.last_mut()) {
            (true, _) if !is_open => spans.push((now, None)),
            (false, Some((_, until))) if is_open => *until = Some(now),
            _ => {}
        }
    }

    /// A message passed the gate.
    ///
    /// # Errors
    /// The certified state does not allow it, it passed before, or it is out of order or too old.
    pub fn passed(&mut self, passed: &Passed<'_>) -> Check {
        let Passed { opening, service, transaction, now, wall, by_block } = *passed;
        let body = transaction.body();
        let argument = |at: usize| {
            let text = body.args.get(at).and_then(|text| std::str::from_utf8(text).ok());
            text.ok_or_else(|| wrong(format!("{service}: no argument {at}")))
        };
        let epoch: u64 = argument(1)?.parse().map_err(|_| wrong("no epoch"))?;
        let number: u64 = argument(2)?.parse().map_err(|_| wrong("no number"))?;
        let id = transaction.id();
        let what = |why: &str| wrong(format!("{service}: {id}, epoch {epoch}, number {number}: {why}"));
        let robot = service.split('/').next().unwrap_or_default();
        if let Some(why) = self.is_stopped(robot, opening, now) {
            return Err(what(&why));
        }
        if argument(0)? != service || body.function != "set" || body.chaincode != "abac" {
            return Err(what("is another call"));
        }
        let people = Arc::clone(&self.people);
        let creator = people.by_fingerprint(&transaction.creator()).ok_or_else(|| what("is signed by nobody"))?;
        if transaction.verify(&creator.identity.public_key).is_err() {
            return Err(what("is not signed by its creator"));
        }
        let signed_at = body.not_after.saturating_sub(micros(COMMAND_TTL));
        // A command passes for `stale_after` after a question. It was signed after that question, or after one that is no older than the
        // longer of MAX_AGE and COMMAND_TTL, or it is no older than that by the certified block time of the answer. A node that lies
        // about block time makes it younger by the difference of the clocks of signer and leader.
        let longest = MAX_AGE.max(micros(COMMAND_TTL)) + CLOCKS_APART + self.stale_after + SLACK;
        let is_too_old = match self.signed.get(&transaction.id()) {
            Some(signed) if by_block => now > signed + longest,
            _ => wall > signed_at.saturating_add(MAX_AGE + SLACK),
        };
        if is_too_old {
            return Err(what("is too old"));
        }
        if !self.is_permitted(creator, service, (&creator.id(), epoch), now) {
            return Err(what(&format!("{} had no right", creator.id())));
        }
        // A bridge that starts anew knows no numbers. It takes nothing that was signed before: by clocks that are not ahead.
        if self.passed.get(&id).is_some_and(|(last, then)| *last == opening || signed_at <= *then) {
            return Err(what("has passed before"));
        }
        self.passed.insert(id, (opening, wall));
        let before = self.reached.insert((opening, service.to_owned(), creator.id(), epoch), number);
        if let Some(reached) = before.filter(|reached| *reached >= number) {
            return Err(what(&format!("after number {reached}")));
        }
        self.drivers.insert(service.to_owned(), (transaction.creator(), epoch));
        Ok(())
    }

    /// A client has signed a message.
    pub fn signed(&mut self, id: Hash, now: u64) {
        self.signed.insert(id, now);
    }

    /// The gate has rejected a message whose age it measures by the block that it names. Nothing has delayed messages for a while.
    ///
    /// # Errors
    /// It was rejected for its age, and is not that old.
    pub fn refused(&self, service: &str, transaction: &Transaction, refused: Refused, now: u64) -> Check {
        let for_its_age = matches!(refused, Refused::TooOld | Refused::Expired | Refused::UnknownBlock);
        let Some(signed) = self.signed.get(&transaction.id()).filter(|_| for_its_age) else { return Ok(()) };
        if now > signed + MAX_AGE - ALLOWANCE {
            return Ok(());
        }
        let id = transaction.id();
        Err(wrong(format!("{service}: {id} is {} us old and rejected: {}", now - signed, refused.name())))
    }

    /// A robot is moving, by what its gate says.
    ///
    /// # Errors
    /// The driver had no right any more, for longer than an answer counts.
    pub fn moves(&self, service: &str, now: u64) -> Check {
        let Some((creator, epoch)) = self.drivers.get(service) else {
            return Err(wrong(format!("{service} is moved by nobody")));
        };
        let creator = self.people.by_fingerprint(creator).ok_or_else(|| wrong("is moved by a stranger"))?;
        let mut grant = Some((creator.id(), *epoch));
        while let Some((holder, epoch)) = grant {
            if self.is_permitted(creator, service, (&holder, epoch), now) {
                return Ok(());
            }
            let next = self.follows.get(&(service.to_owned(), epoch));
            grant = next.filter(|(_, later)| *later > epoch).cloned();
        }
        Err(wrong(format!("{service} is not stopped: {} has lost epoch {epoch}", creator.id())))
    }

    /// Did the state allow it, by that holder's grant of an epoch, at a moment that is not longer ago than an answer counts?
    fn is_permitted(&self, creator: &Person, service: &str, (holder, epoch): (&str, u64), now: u64) -> bool {
        let since = now.saturating_sub(self.stale_after + SLACK);
        let key = (hex::encode(creator.identity.issuer), hex::encode(&creator.identity.serial));
        let revoked = self.revoked.get(&key).copied().unwrap_or(u64::MAX);
        let held = |(from, until): &Span| since.max(*from) <= now.min(until.unwrap_or(u64::MAX)).min(revoked);
        let grant = self.grants.get(&(service.to_owned(), holder.to_owned(), epoch));
        let open = self.open.get(service).filter(|_| epoch == 0);
        grant.is_some_and(held) || open.is_some_and(|spans| spans.iter().any(held))
    }
}

fn wrong(what: impl Into<String>) -> Violation {
    Violation::new(NAME, what)
}

fn micros(duration: std::time::Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap_or(u64::MAX)
}
