//! The clients: what they want, how they retry, and what they remember.

mod confide;
mod contest;
mod enrol;
mod fleet;
mod govern;
mod intent;
mod pass_on;
mod publish;
mod subscribe;
mod tasks;

pub(crate) use confide::{BRIDGE, Circle};
pub use contest::Terms;
pub use fleet::{SERVICES, robots};
pub(crate) use govern::Book;
pub use govern::Draft;
pub use intent::Call;
pub(crate) use subscribe::READERS;
pub use tasks::Heard;

use crate::clock::{EPOCH, MILLISECOND, SECOND};
use crate::history::{Asks, Kind, Outcome, Verdict};
use crate::invariant::Check;
use crate::node::{Answer, Reply, Request, What};
use crate::people::{CERTIFICATES, Person};
use crate::world::{Event, World};
use bytes::Bytes;
use ledger::transaction::{Body, KnownBlock, Transaction};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Class, Code};
use ledger_contract::Envelope;
use ledger_gate::gate::COMMAND_TTL;
use serde::Deserialize;
use std::collections::BTreeMap;

/// How often an operation is tried before its client gives it up.
const TRIES_MAX: u64 = 8;

/// Does little but read, often.
pub(crate) const READER: &str = "Org2/Owen";

/// A program that uses the ledger for somebody.
pub struct Client {
    /// `Org1/Salma`.
    pub person: String,
    /// Which of the person's certificates.
    pub nth: usize,
    /// The node that it talks to.
    pub gateway: u64,
    /// The newest height that it has seen.
    pub seen: u64,
    /// Grants that it believes to have: epoch and next sequence number.
    pub grants: BTreeMap<String, (u64, u64)>,
    /// By how much the nodes' time is ahead of virtual time.
    ahead: u64,
    /// The newest block of which its node has told, and when.
    known: Option<(u64, Hash, u64)>,
    /// Everything about an earlier attempt is void.
    pub attempt: u64,
    /// Counts its crashes: each begins a new session.
    pub session: u64,
    /// The operation under way: its number, what it is, and how often it was tried.
    doing: Option<(usize, What, u64)>,
    /// The call under way.
    call: Option<Call>,
    /// The ledger knows its certificate.
    introduced: bool,
    /// The robots are set up; only the owner's client cares.
    pub ready: bool,
    /// Its work whatever the plan; for the last word of a run.
    pub orders: Vec<Call>,
    /// It does nothing of its own any more.
    pub obedient: bool,
    /// It takes every verdict for an answer to its orders.
    pub obliging: bool,
    /// Verdicts of its orders.
    pub obeyed: Vec<Code>,
    /// Its knowledge about the confidential service.
    pub(crate) circle: Circle,
}

/// The fields that are read of a grant.
#[derive(Deserialize)]
struct Granted {
    service: String,
    epoch: u64,
    next_seq: u64,
}

impl Client {
    /// Its node has told of a block.
    fn knows(&mut self, height: u64, block: Option<Hash>, now: u64) {
        if let Some(hash) = block.filter(|_| self.known.is_none_or(|(known, ..)| height > known)) {
            self.known = Some((height, hash, now));
        }
    }

    /// The newest block that it knows, as its commands name it.
    fn known_block(&self, now: u64) -> Option<KnownBlock> {
        let (height, hash, since) = self.known?;
        let hash = Bytes::copy_from_slice(&KnownBlock::prefix(&hash.0)?);
        Some(KnownBlock { height, hash, known_us: now - since })
    }

    fn new(person: &str, gateway: u64) -> Self {
        Self {
            person: person.to_owned(),
            nth: 0,
            gateway,
            seen: 0,
            grants: BTreeMap::new(),
            ahead: EPOCH,
            known: None,
            attempt: 0,
            session: 0,
            doing: None,
            call: None,
            introduced: false,
            ready: false,
            orders: Vec::new(),
            obedient: false,
            obliging: false,
            obeyed: Vec::new(),
            circle: Circle::default(),
        }
    }

    /// The client of a robot's bridge: it does nothing of its own.
    pub(crate) fn for_robot(person: &str) -> Self {
        Self { obedient: true, ..Self::new(person, 0) }
    }

    /// Is it doing something?
    pub fn is_busy(&self) -> bool {
        self.doing.is_some()
    }

    /// It dies, and whoever starts it again knows nothing of what it was doing.
    pub fn crash(&mut self) {
        self.attempt += 1;
        self.session += 1;
        self.seen = 0;
        self.known = None;
        self.grants.clear();
        self.circle.crash();
        self.doing = None;
        self.call = None;
    }
}

impl World {
    /// Hires the clients of the plan: the owner, an admin, and users.
    pub(crate) fn employ(&mut self) {
        let users = ["Org1/Salma", "Org1/Farhad", "Org1/Nina", "Org2/Owen", "Org1/Salma", "Org3/Trudy", "Org2/Mallory"];
        let nodes = self.plan.voters + self.plan.learners;
        for nth in 0..self.plan.clients {
            let person = match nth {
                0 => "Org2/admin",
                1 => "Org1/admin",
                2 => READER,
                _ => self.random.clients.pick(&users).copied().unwrap_or("Org1/Salma"),
            };
            let gateway = self.random.clients.between(1, nodes);
            self.clients.push(Client::new(person, gateway));
            let delay = self.random.clients.below(SECOND);
            self.schedule(delay, Event::Client { client: nth, attempt: 0 });
        }
        self.enrol();
        self.employ_a_robot();
        self.employ_a_chief();
        self.employ_a_circle();
    }

    /// Adds a client that does only what it is told, and tells it.
    pub(crate) fn employ_for(&mut self, person: &str, orders: Vec<Call>, obliging: bool) -> usize {
        let number = self.clients.len();
        let gateway = self.gateways().first().copied().unwrap_or(1);
        let mut client = Client::new(person, gateway);
        client.nth = if self.people.index(person, CERTIFICATES - 1).is_some() { CERTIFICATES - 1 } else { 0 };
        client.ahead = self.clients.iter().map(|client| client.ahead).max().unwrap_or(EPOCH);
        client.orders = orders;
        client.obedient = true;
        client.obliging = obliging;
        self.clients.push(client);
        self.schedule(1, Event::Client { client: number, attempt: 0 });
        number
    }

    /// A client has time: a new operation, or another try if nobody has answered.
    pub(crate) fn work(&mut self, number: usize, attempt: u64) {
        let Some(client) = self.clients.get_mut(number).filter(|client| client.attempt == attempt) else { return };
        if client.doing.is_some() {
            // Nobody has answered: another node may.
            self.coverage.timeouts += 1;
            return self.again(number, true);
        }
        if self.clients[number].obedient && self.clients[number].orders.is_empty() {
            return;
        }
        self.begin(number);
    }

    /// Begins an operation.
    fn begin(&mut self, number: usize) {
        let Some(call) = self.intend(number) else {
            return self.rest(number);
        };
        self.coverage.operations += 1;
        let client = &self.clients[number];
        let Some(person) = self.people.index(&client.person, client.nth) else { return };
        let (session, seen) = (client.session, client.seen);
        let (kind, what) = match &call {
            Call::Read { asks, service, linearizable } => {
                let (asks, service, linearizable) = (*asks, service.clone(), *linearizable);
                let kind = Kind::Read { asks, person, service: service.clone(), linearizable, min_height: seen };
                (kind, What::Read { asks, person, service, may_be_stale: !linearizable })
            }
            call => {
                let whole = self.whole_set(person, call);
                let (chaincode, function, args) = whole.as_ref().unwrap_or(call).transaction();
                let valid = self.random.clients.between(5, 60) * SECOND;
                let not_after = client.ahead + self.now + self.valid(function, valid);
                let introduce = !client.introduced || self.random.clients.percent(10);
                let nonce = self.random.clients.number();
                let whose = &self.people.all[person];
                let known = client.known_block(self.now);
                let call = (chaincode, function, args);
                let transaction = sign_knowing(whose, self.network, nonce, not_after, call, introduce, known);
                self.invariants.gate.signed(transaction.id(), self.now);
                let encoded = transaction.encoded().clone();
                let kind = Kind::Submit { id: transaction.id(), encoded: encoded.clone() };
                (kind, What::Submit { transaction: encoded, first_attempt: true })
            }
        };
        let operation = self.history.begin(number, session, self.now, kind);
        let name = call.name();
        let client = &mut self.clients[number];
        client.call = Some(call);
        client.doing = Some((operation, what, 0));
        let person = client.person.clone();
        self.note(format_args!("c{number} {person} begins {operation}: {name}"));
        self.again(number, false);
    }

    /// How long a call is valid, microseconds. Where a robot is looked at, commands are signed as bridges sign them.
    pub(crate) fn valid(&self, function: &str, otherwise: u64) -> u64 {
        let is_command = self.robot.is_some() && function == "set";
        if is_command { COMMAND_TTL.as_micros() as u64 } else { otherwise }
    }

    /// Sends what the client is doing, perhaps to another node; gives it up after a while.
    fn again(&mut self, number: usize, elsewhere: bool) {
        let nodes = self.gateways();
        let client = &mut self.clients[number];
        let told = self.invariants.answered_is_seen.told();
        let Some((_, what, tries)) = client.doing.as_mut() else { return };
        if *tries >= TRIES_MAX {
            client.doing = None;
            client.call = None;
            return self.rest(number);
        }
        *tries += 1;
        if let What::Submit { first_attempt, .. } = what {
            // From the second time on a copy may be anywhere: at a node that stands still, or on its way.
            *first_attempt = *tries == 1;
        }
        let what = what.clone();
        client.attempt += 1;
        let elsewhere = elsewhere || !nodes.contains(&client.gateway);
        if elsewhere && let Some(node) = self.random.clients.pick(&nodes) {
            client.gateway = *node;
        }
        let reply = Reply { client: number, attempt: client.attempt };
        let (attempt, gateway) = (client.attempt, client.gateway);
        let request = Request { reply, min_height: client.seen, told, stream: number as u64, what };
        if let Some(at) = self.links.client(self.now, &mut self.random.network, &mut self.coverage) {
            self.schedule_at(at, Event::Request { node: gateway, request });
        }
        let patience = self.random.clients.between(500 * MILLISECOND, 3 * SECOND);
        self.schedule(patience, Event::Client { client: number, attempt });
    }

    /// An answer arrives.
    pub(crate) fn answered(&mut self, reply: Reply, clock: u64, answer: Answer) -> Check {
        let number = reply.client;
        if self.robot.as_ref().is_some_and(|robot| robot.client == number) {
            return self.robot_answered(reply, clock, answer);
        }
        let (now, late) = (self.now, self.clients[number].attempt != reply.attempt);
        let client = &mut self.clients[number];
        client.ahead = clock.saturating_sub(now).max(client.ahead / 2);
        let Some((operation, ..)) = client.doing.clone() else { return Ok(()) };
        // Whoever has asked again waits for that answer and no other.
        if late {
            return Ok(());
        }
        let result = match answer {
            Answer::Verdict { height, index, block, code, response } => {
                client.knows(height, block, now);
                let id = match &self.history.operations[operation].kind {
                    Kind::Submit { id, .. } => *id,
                    Kind::Read { .. } => Hash::ZERO,
                };
                let verdict = Verdict { id, height, index, code, response };
                self.history.verdicts.push(verdict.clone());
                client.seen = client.seen.max(height);
                self.learn(number, verdict.code, &verdict.response);
                Outcome::Executed(verdict)
            }
            Answer::Refused(refused) if is_passing(refused.code) => {
                // It may still be ordered, or not: the same again, a little later.
                let client = &mut self.clients[number];
                client.attempt += 1;
                let attempt = client.attempt;
                let pause = self.random.clients.between(20 * MILLISECOND, 300 * MILLISECOND);
                self.schedule(pause, Event::Client { client: number, attempt });
                return Ok(());
            }
            Answer::Refused(refused) => {
                if let Kind::Submit { id, .. } = &self.history.operations[operation].kind {
                    self.invariants.refused_is_final.refused(client.gateway, id, refused.code)?;
                }
                self.learn(number, refused.code, &Bytes::new());
                Outcome::Refused { code: refused.code, judged: refused.judged, never: refused.code.is_final() }
            }
            Answer::Value { height, judged_at, code, response } => {
                client.seen = client.seen.max(height);
                if let (Some(Call::Read { asks: Asks::Readers, .. }), Code::Ok) = (&client.call, code) {
                    client.read_of_the_circle(&response);
                }
                Outcome::Read { height, judged_at, code, response }
            }
        };
        self.coverage.answered += 1;
        if matches!(self.history.operations[operation].kind, Kind::Read { linearizable: true, .. }) {
            self.coverage.linearizable += 1;
        }
        self.note(format_args!("c{number} ends {operation}"));
        self.history.end(operation, now, result);
        self.rest(number);
        Ok(())
    }

    /// The nodes that clients are told to use.
    pub(crate) fn gateways(&self) -> Vec<u64> {
        self.desired.voters.iter().chain(&self.desired.learners).copied().collect()
    }

    /// The client does nothing for a while.
    fn rest(&mut self, number: usize) {
        let think = self.random.clients.around(self.plan.think);
        let client = &mut self.clients[number];
        let think = match &*client.person {
            _ if client.circle.belongs => think / 3 + 1,
            READER => think / 8 + 1,
            _ => think,
        };
        client.doing = None;
        client.call = None;
        client.attempt += 1;
        let attempt = client.attempt;
        self.schedule(think, Event::Client { client: number, attempt });
    }

    /// The client's reading of a verdict.
    fn learn(&mut self, number: usize, code: Code, response: &Bytes) {
        let Some(call) = self.clients[number].call.clone() else { return };
        if call.is_about_tasks() {
            self.hear_of_tasks(code, &call, response);
        }
        if let (Code::Held, Call::Acquire { service, .. } | Call::Contend { service, .. }) = (code, &call)
            && service.ends_with(READERS)
        {
            self.coverage.contest("place full");
        }
        self.coverage.governs(&call, code);
        self.coverage.answers_in_secret(&call, code);
        let client = &mut self.clients[number];
        if let Some(order) = client.orders.first() {
            // What is not settled is tried again.
            let passing = matches!(code, Code::Expired | Code::NotAfterTooFar | Code::UnknownCreator);
            let lost = matches!(code, Code::Held | Code::NotHolder | Code::StaleEpoch | Code::ReadersChanged);
            let settled = !passing && (client.obliging || !lost);
            if settled && std::mem::discriminant(order) == std::mem::discriminant(&call) {
                client.orders.remove(0);
                client.obeyed.push(code);
            }
        }
        client.introduced = code != Code::UnknownCreator;
        client.hear_of_the_circle(code, &call, response);
        match (code, call) {
            (
                Code::Ok,
                Call::Acquire { service, .. }
                | Call::Contend { service, .. }
                | Call::Take { service }
                | Call::Recall { service, .. }
                | Call::Renew { service },
            ) => {
                if let Ok(Granted { epoch, next_seq, .. }) = serde_json::from_slice(response) {
                    client.grants.insert(service, (epoch, next_seq));
                }
            }
            (Code::Ok, Call::AcquireAll { .. }) => {
                let granted: Vec<Granted> = serde_json::from_slice(response).unwrap_or_default();
                let granted = granted.into_iter().map(|grant| (grant.service, (grant.epoch, grant.next_seq)));
                client.grants.extend(granted);
            }
            (Code::Ok, Call::Delegate { service, .. } | Call::HandOver { service, .. }) => {
                client.grants.remove(&service);
            }
            (Code::Ok, Call::Set { service, epoch, seq }) => {
                client.grants.insert(service, (epoch, seq + 1));
            }
            (Code::Ok, Call::Setup { .. }) => client.ready = true,
            (_, Call::Set { service, .. } | Call::Release { service } | Call::Renew { service }) => {
                client.grants.remove(&service);
            }
            (Code::Revoked, _) if client.nth + 2 < CERTIFICATES => {
                client.nth += 1;
                client.introduced = false;
                client.grants.clear();
            }
            _ => {}
        }
    }
}

/// Repeating it may help.
fn is_passing(code: Code) -> bool {
    code.class() == Class::Unreachable || code == Code::DiskFull
}

/// Signs a call.
pub fn sign(
    whose: &Person,
    network: Hash,
    nonce: u64,
    not_after: u64,
    call: (&str, &str, Vec<Bytes>),
    introduce: bool,
) -> Transaction {
    sign_knowing(whose, network, nonce, not_after, call, introduce, None)
}

/// Signs a call that names the newest block that the signer knows.
pub fn sign_knowing(
    whose: &Person,
    network: Hash,
    nonce: u64,
    not_after: u64,
    (chaincode, function, mut args): (&str, &str, Vec<Bytes>),
    introduce: bool,
    known_block: Option<KnownBlock>,
) -> Transaction {
    // No two commands are alike: what reaches a robot names its transaction. Envelopes are not alike anyway.
    let in_the_clear = |payload: &&mut Bytes| function == "set" && Envelope::parse(payload).is_none();
    if let Some(payload) = args.get_mut(3).filter(in_the_clear) {
        *payload = [&payload[..], &nonce.to_be_bytes()].concat().into();
    }
    let body = Body {
        network: Bytes::copy_from_slice(&network.0),
        creator: Bytes::copy_from_slice(&whose.fingerprint().0),
        nonce: [nonce.to_be_bytes(), whose.fingerprint().0[..8].try_into().unwrap()].concat().into(),
        not_after,
        chaincode: chaincode.into(),
        function: function.into(),
        args,
        known_block,
    };
    let transaction = Transaction::sign(&body, &whose.key).unwrap();
    if introduce { transaction.with_certificate(whose.certificate.clone()).unwrap() } else { transaction }
}
