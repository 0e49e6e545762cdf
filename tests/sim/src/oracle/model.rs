//! The rights of everybody, in as few words as possible.

mod confirm;
mod contest;
mod delegate;
mod ends;
mod enrol;
mod grants;
mod lists;
mod network;
mod policies;
mod proposals;
mod readers;
mod services;
mod sets;
mod tasks;

use crate::lists::Lists;
use crate::people::{People, Person};
use crate::plan::Plan;
use crate::policy::Policy;
use bytes::Bytes;
use ends::Why;
use ledger::members::Membership;
use ledger::transaction::{NOT_AFTER_AHEAD_MAX, Transaction};
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use ledger_identity::Role;
use network::Nodes;
use readers::Circle;
pub(super) use readers::Listed;
use services::{Robot, Service};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
pub(super) use tasks::State;
use tasks::Task;

/// The world as far as the simulated people can change it.
#[derive(Clone)]
pub(super) struct Model {
    people: Arc<People>,
    network: Hash,
    /// Certificates that the ledger knows, and those that nodes have recorded.
    known: BTreeSet<Hash>,
    enrolled: enrol::Enrolled,
    /// Issuer and serial in hexadecimal.
    revoked: BTreeSet<(String, String)>,
    /// Transactions that were executed.
    done: BTreeSet<Hash>,
    robots: BTreeMap<String, Robot>,
    /// By organisation and id.
    policies: BTreeMap<(String, String), Policy>,
    governance: sets::Governance,
    proposals: proposals::Proposals,
    lists: lists::Kept,
    /// Newest epoch of each service.
    epochs: BTreeMap<String, u64>,
    /// Of each service, oldest first.
    grants: BTreeMap<String, Vec<Grant>>,
    /// Of each service, in order of arrival.
    lines: BTreeMap<String, Vec<contest::Waiter>>,
    /// All that ever were, the one with number 1 first.
    tasks: Vec<Task>,
    /// Of each service, by name.
    asking: confirm::Askings,
    /// Of each confidential service.
    circles: BTreeMap<String, Circle>,
    /// How many certificates were revoked, and the height of the newest revocation.
    newest_revocation: (usize, u64),
    /// Robots.
    stopped: BTreeSet<String>,
    /// Epoch and number of the last message: of a service for one, or of each publisher of one for all.
    last: BTreeMap<(String, String), (u64, u64)>,
    /// Nodes, and what they attest.
    network_of_nodes: Nodes,
}

/// A grant that has not ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Grant {
    pub(super) holder: String,
    pub(super) certificate: Hash,
    pub(super) epoch: u64,
    /// Block time, microseconds.
    pub(super) expires: u64,
    lease_ms: u64,
    priority: i64,
    /// Since when the service is held without a break.
    since: u64,
    chain: delegate::Chain,
    /// The task that it serves.
    task: Option<u64>,
}

/// A verdict, and what of the response can be told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Judged {
    pub(super) code: Code,
    /// Of a grant: epoch and expiry.
    pub(super) grant: Option<(u64, u64)>,
    /// Of a place in line: position, priority, and until when.
    pub(super) place: Option<(u64, i64, u64)>,
    /// Of a task: number, state, and how many points were reached.
    pub(super) task: Option<(u64, State, u64)>,
    /// Of policies that changed: the number of the set.
    pub(super) version: Option<u64>,
    /// Of a proposed set.
    pub(super) agreed: Option<Agreed>,
}

/// The admins who agree to a set, and how many more must.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Agreed {
    pub(super) by: BTreeSet<String>,
    pub(super) missing: u64,
}

impl From<Code> for Judged {
    fn from(code: Code) -> Self {
        Self { code, grant: None, place: None, task: None, version: None, agreed: None }
    }
}

type Verdict = Result<Judged, Code>;

impl Model {
    pub(super) fn new(people: &Arc<People>, network: Hash, plan: &Plan, signed: &Lists) -> Self {
        Self {
            people: Arc::clone(people),
            network,
            known: BTreeSet::new(),
            enrolled: enrol::Enrolled::default(),
            revoked: BTreeSet::new(),
            done: BTreeSet::new(),
            robots: BTreeMap::new(),
            policies: BTreeMap::new(),
            governance: sets::Governance::default(),
            proposals: proposals::Proposals::new(),
            lists: lists::Kept::new(signed),
            epochs: BTreeMap::new(),
            grants: BTreeMap::new(),
            lines: BTreeMap::new(),
            tasks: Vec::new(),
            asking: confirm::Askings::new(),
            circles: BTreeMap::new(),
            newest_revocation: (0, 0),
            stopped: BTreeSet::new(),
            last: BTreeMap::new(),
            network_of_nodes: Nodes::founded(plan.voters, plan.learners, plan.organisations),
        }
    }

    /// Everybody.
    pub(super) fn people(&self) -> &People {
        &self.people
    }

    /// Later calls are executed in the block of this height, or judged by its rules.
    pub(super) fn next(&mut self, height: u64, members: &Membership) {
        self.network_of_nodes.next(height, members);
    }

    /// A block begins: what is due ends, and turns come.
    pub(super) fn begin(&mut self, time: u64) {
        self.end_everywhere(Why::Failed, time, |grant| grant.expires <= time);
        self.turns(time);
    }

    /// Executes a transaction at a block time.
    pub(super) fn execute(&mut self, transaction: Option<&Transaction>, time: u64) -> Judged {
        let Some(transaction) = transaction else { return Code::Malformed.into() };
        let before = self.clone_small();
        let verdict = self.authenticate(transaction, time).and_then(|creator| {
            self.done.insert(transaction.id());
            self.known.insert(transaction.creator());
            let people = Arc::clone(&self.people);
            self.call((&people.all[creator], creator), transaction, time)
        });
        match verdict {
            Ok(judged) => judged,
            Err(code) => {
                self.restore(before);
                code.into()
            }
        }
    }

    /// The same before a block whose rules are new: a node that does not speak them answers by those of the block before.
    pub(super) fn by_older_rules(&self) -> Option<Self> {
        let mut copy = self.clone();
        copy.network_of_nodes.keep_rules().then_some(copy)
    }

    /// The answer of a gateway at this state and time; nothing changes.
    pub(super) fn admit(&self, transaction: &Transaction, time: u64) -> Code {
        if self.done.contains(&transaction.id()) {
            return Code::Duplicate;
        }
        self.clone().execute(Some(transaction), time).code
    }

    /// The checks before any chaincode runs, in their order.
    fn authenticate(&self, transaction: &Transaction, time: u64) -> Result<usize, Code> {
        let body = transaction.body();
        // Ids are remembered as long as they could be used.
        if self.done.contains(&transaction.id()) && body.not_after >= time {
            return Err(Code::Duplicate);
        }
        if body.network != self.network.0[..] {
            return Err(Code::WrongNetwork);
        }
        if body.not_after < time {
            return Err(Code::Expired);
        }
        if body.not_after > time + NOT_AFTER_AHEAD_MAX {
            return Err(Code::NotAfterTooFar);
        }
        if !self.known.contains(&transaction.creator()) && transaction.certificate().is_none() {
            return Err(Code::UnknownCreator);
        }
        let at = self.people.all.iter().position(|person| person.fingerprint() == transaction.creator());
        let at = at.ok_or(Code::UnknownCreator)?;
        let person = &self.people.all[at];
        if self.is_revoked(person) {
            return Err(Code::Revoked);
        }
        transaction.verify(&person.identity.public_key).map_err(|_| Code::BadSignature)?;
        Ok(at)
    }

    /// Is one of the people's certificates revoked?
    pub(super) fn is_revoked_now(&self, person: usize) -> bool {
        self.is_revoked(&self.people.all[person])
    }

    fn is_revoked(&self, person: &Person) -> bool {
        self.revoked.contains(&(hex::encode(person.identity.issuer), hex::encode(&person.identity.serial)))
    }

    fn call(&mut self, (who, person): (&Person, usize), transaction: &Transaction, time: u64) -> Verdict {
        let body = transaction.body();
        let text = |at: usize| body.args.get(at).map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        let first = text(0).unwrap_or_default();
        match (&*body.chaincode, &*body.function) {
            ("abac", "acquire") => self.acquire((who, person), &first, text(1), time),
            ("abac", "acquire_all") => self.acquire_all((who, person), &body.args, time),
            ("abac", "delegate") => self.pass_on(who, &body.args, false, time),
            ("abac", "handover") => self.pass_on(who, &body.args, true, time),
            ("abac", "recall") => self.recall(who, &body.args, time),
            ("abac", "confirm") => self.confirm(who, person, &first, &text(1).unwrap_or_default(), time),
            ("abac", "take") => self.take(who, &first, time),
            ("abac", "stop") => self.emergency(who, &first, true, time),
            ("abac", "resume") => self.emergency(who, &first, false, time),
            ("abac", "configure") => self.configure(who, &first, &text(1).unwrap_or_default(), time),
            ("abac", "renew") => self.renew(who, &first, number(text(1))?, time),
            ("abac", "release") => self.release(who, &first, time),
            ("abac", "set") => {
                let (epoch, seq) = (number(text(1))?.unwrap_or(0), number(text(2))?.unwrap_or(0));
                self.set(who, &first, (epoch, seq), body.args.get(3), time)
            }
            ("abac", "reader") => self.reader((who, person), &body.args, time),
            ("abac", "share") => self.share(who, &body.args, time),
            ("abac", "submit") => self.submit((who, person), &first, &text(1).unwrap_or_default(), time),
            ("abac", "progress") => self.progress(who, number(text(0))?, number(text(1))?, time),
            ("abac", "fail") => self.fail(who, number(text(0))?, time),
            ("abac", "cancel") => self.cancel(who, number(text(0))?, time),
            ("abac", "declare") if self.robots.contains_key(&first) => Ok(Code::Ok.into()),
            ("abac", "declare") => Err(Code::UnknownRobot),
            ("abac", "replace") => self.replace(who, &body.args, time),
            ("abac", "policy") => self.policy((who, person), &first, &text(1).unwrap_or_default(), text(2), time),
            ("msp", "join_node") => self.network_of_nodes.join(who, &first),
            ("msp", "set_node_role") => self.network_of_nodes.set_role(who, &first),
            ("msp", "carry_ca") => self.carry(who, &first),
            ("msp", "record_certificate") => self.record(who, &first),
            ("msp", "speak") => self.network_of_nodes.speak(who, &first),
            ("msp", "activate_rules") => self.network_of_nodes.activate(who, &first),
            ("msp", "attest") => self.network_of_nodes.attest(who, &first),
            ("msp", "propose") => self.propose_rule((who, person), &first),
            ("msp", "record_revocation_list") => self.record_list(who, &first, time),
            ("msp", "revoke") => self.revoke(who, &first, &text(1).unwrap_or_default(), time),
            (chaincode, function) => panic!("the model does not know {chaincode} {function}"),
        }
    }

    fn replace(&mut self, who: &Person, robots: &[Bytes], time: u64) -> Verdict {
        only_admins(who)?;
        let mut replaced = Vec::new();
        for robot in robots {
            let robot = Robot::read(robot, &who.identity.organisation)?;
            replaced.push(robot.name.clone());
            self.robots.insert(robot.name.clone(), robot);
        }
        self.end_unfit(|robot| replaced.contains(&robot.name), time);
        Ok(Code::Ok.into())
    }

    fn policy(
        &mut self,
        (who, person): (&Person, usize),
        verb: &str,
        argument: &str,
        text: Option<String>,
        time: u64,
    ) -> Verdict {
        match verb {
            "apply" => self.apply(who, argument, time),
            "propose" => self.propose((who, person), argument, time),
            "approve" => self.approve((who, person), argument, time),
            "withdraw" => self.withdraw(who, argument, time),
            "enact" => self.enact(who, argument, text.is_some(), time),
            verb => panic!("the model does not know policy {verb}"),
        }
    }

    fn revoke(&mut self, who: &Person, issuer: &str, serial: &str, time: u64) -> Verdict {
        let issued = |person: &&Person| hex::encode(person.identity.issuer) == issuer;
        let organisation = self.people.all.iter().find(issued).map(|person| person.identity.organisation.clone());
        if who.identity.role != Role::Admin || Some(&who.identity.organisation) != organisation.as_ref() {
            return Err(Code::NotAdmin);
        }
        self.revoked.insert((issuer.to_owned(), serial.to_owned()));
        self.forget_the_revoked(time);
        Ok(Code::Ok.into())
    }

    /// A revoked certificate holds nothing, waits for nothing, and agrees to nothing.
    fn forget_the_revoked(&mut self, time: u64) {
        let people = Arc::clone(&self.people);
        let revoked: BTreeSet<usize> = (0..people.all.len()).filter(|person| self.is_revoked_now(*person)).collect();
        let fingerprints: BTreeSet<Hash> = revoked.iter().map(|person| people.all[*person].fingerprint()).collect();
        let is_theirs = |grant: &Grant| grant.certificates().any(|certificate| fingerprints.contains(certificate));
        self.end_everywhere(Why::Failed, time, is_theirs);
        self.leave_all(|certificate| fingerprints.contains(certificate), time);
        self.approvals_without(|person| revoked.contains(&person));
        self.read_no_more(|person| revoked.contains(&person));
    }
}

fn only_admins(who: &Person) -> Result<(), Code> {
    if who.identity.role == Role::Admin { Ok(()) } else { Err(Code::NotAdmin) }
}

fn number(text: Option<String>) -> Result<Option<u64>, Code> {
    text.map(|text| text.parse().map_err(|_| Code::BadArgument)).transpose()
}
