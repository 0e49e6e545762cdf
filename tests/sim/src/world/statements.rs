//! Voters state what they have executed, liars among them state something else, and everybody makes certificates.

use super::{Event as Happening, World};
use crate::invariant::Check;
use crate::people::People;
use bytes::Bytes;
use ledger::{Ledger, Outcome};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use ledger_identity::msp::Msps;
use ledger_light::{Certificate, Head, Proof, Signature, Signed, Statement, Transfer, Vote};
use ledger_replica::certifier::{Certifiable, Certifier, Earlier, Effect, Era, Event, Signing};
use std::sync::Arc;

/// Most statements in the record of a node.
const SIGNED_MAX: usize = 64;
/// Most recent certificates of a node.
const CERTIFICATES_MAX: usize = 128;

/// The keys of a node, and the certificates that it believes.
pub struct Keys {
    id: u64,
    people: Arc<People>,
    organisations: usize,
}

impl Signing for Keys {
    fn sign(&self, statement: &Statement) -> Result<Signed, Rejection> {
        let node = self.people.node(self.id, self.organisations);
        statement.sign(self.id, node.certificate.clone(), &node.key)
    }

    fn sign_vote(&self, vote: &Vote) -> Result<Signature, Rejection> {
        let node = self.people.node(self.id, self.organisations);
        vote.sign(node.certificate.clone(), &node.key)
    }

    fn sign_transfer(&self, transfer: &Transfer) -> Result<Signature, Rejection> {
        let node = self.people.node(self.id, self.organisations);
        transfer.sign(node.certificate.clone(), &node.key)
    }

    fn sign_head(&self, head: &Head) -> Result<Signature, Rejection> {
        let node = self.people.node(self.id, self.organisations);
        head.sign(node.certificate.clone(), &node.key)
    }

    fn identify(&self, msps: &Arc<Msps>, certificate: &[u8], _time: u64) -> Result<Identity, Rejection> {
        // Every certificate was verified when it was made.
        let found = self.people.by_fingerprint(&Hash::of(&[certificate])).map(|person| person.identity.clone());
        let trusted = found.filter(|identity| msps.get(&identity.organisation).is_some());
        trusted.ok_or_else(|| Rejection::new(Code::Untrusted, "nobody knows this certificate"))
    }
}

/// The voters whose statements count for the blocks after the newest.
fn era(ledger: &Ledger) -> Era {
    Era { from: ledger.tip().height + 1, voters: ledger.voters().unwrap(), msps: ledger.msps() }
}

impl World {
    /// The certifier of a node that starts, whose log ends at this height.
    pub(super) fn certifier(&self, id: u64, ledger: &Ledger, end: u64) -> Certifier<Keys> {
        let signed = self.nodes.get(&id).map(|node| node.signed.iter().copied().collect()).unwrap_or_default();
        Certifier::new(id, self.network, self.keys(id), era(ledger), Earlier { end, signed })
    }

    /// The keys of a node.
    pub(super) fn keys(&self, id: u64) -> Keys {
        Keys { id, people: Arc::clone(&self.people), organisations: self.plan.organisations }
    }

    /// A node has executed a block.
    pub(super) fn state(&mut self, id: u64, ledger: &Ledger, outcome: &Outcome) -> Check {
        let governs = outcome.governs;
        if let Some(roots) = outcome.certifiable {
            if let Some(running) = self.running(id) {
                running.stated = outcome.header.height;
            }
            let (height, time, block) = (outcome.header.height, outcome.header.time, outcome.hash);
            let block = Certifiable { height, time, block, results: roots.results };
            self.certify(id, Event::Executed { block, governs })?;
            // Nobody is recovered by force here.
            let truth = Statement {
                network: self.network,
                recoveries: 0,
                height,
                time,
                block: outcome.hash,
                results: roots.results,
            };
            self.state_falsely(id, truth)?;
        }
        if governs { self.certify(id, Event::Voters(era(ledger))) } else { Ok(()) }
    }

    /// A statement arrives.
    pub(super) fn hear(&mut self, from: u64, to: u64, signed: &Bytes) -> Check {
        // Only statements are sent here.
        self.certify(to, Event::Heard { from, signed: Signed::from_bytes(signed).unwrap() })
    }

    /// Statements that may have been lost are told again, and those whose blocks are on the disk now for the first time.
    pub(super) fn tell_again(&mut self, id: u64) -> Check {
        self.certify(id, Event::Time)
    }

    fn certify(&mut self, id: u64, event: Event) -> Check {
        let now = self.now;
        let Some(running) = self.running(id) else { return Ok(()) };
        let mut effects = Vec::new();
        let durable = running.store.durable_index();
        running.certifier.step(now, event, &mut effects);
        running.certifier.step(now, Event::Durable(durable), &mut effects);
        for effect in effects {
            match effect {
                Effect::Tell(signed) => {
                    self.invariants.certified.signed(id, &signed, durable)?;
                    if !self.lies(id) {
                        self.tell_all(id, &signed);
                    }
                }
                Effect::Certified { certificate, governs } => {
                    self.coverage.certificates += 1;
                    self.keep(id, &certificate, governs);
                    let height = certificate.statement.height as usize;
                    let block = self.blocks.get(height - 1).map(|block| &block.outcome);
                    // As of the block before: the first members are those of the genesis.
                    let voters = (&self.members[height - 1], self.strict[height - 1]);
                    let (people, organisations) = (&self.people, self.plan.organisations);
                    self.invariants.certified.made(id, &certificate, block, voters, &|node| {
                        people.node(node, organisations).identity.clone()
                    })?;
                }
                Effect::Record(statement) => {
                    let Some(node) = self.nodes.get_mut(&id) else { continue };
                    node.signed.push_back(statement);
                    if node.signed.len() > SIGNED_MAX {
                        node.signed.pop_front();
                    }
                }
                Effect::Pass(signed) => self.tell_all(id, &signed),
                Effect::Misbehaved(proof) => {
                    let node = proof.node();
                    let (count, what) = match proof.is_lie() {
                        true => (&mut self.coverage.lies_proved, "has lied"),
                        false => (&mut self.coverage.faults_proved, "has computed a block in two ways"),
                    };
                    *count += 1;
                    self.note(format_args!("n{id} proves that n{node} {what}"));
                    self.invariants.certified.lied(node, self.liar)?;
                }
            }
        }
        Ok(())
    }

    /// A node keeps a certificate: for a while, or on its disk if the block changed who governs.
    fn keep(&mut self, id: u64, certificate: &Certificate, governs: bool) {
        let Some(node) = self.nodes.get_mut(&id) else { return };
        let Some(running) = &mut node.up else { return };
        let height = certificate.statement.height;
        let facts = if governs { running.ledger.shown(height, |_| false).unwrap() } else { None };
        if let Some(facts) = facts {
            node.governing.insert(height, Proof { certificate: certificate.clone(), facts });
        }
        running.certificates.insert(height, certificate.clone());
        if running.certificates.len() > CERTIFICATES_MAX {
            running.certificates.pop_first();
        }
    }

    /// Does this node lie?
    fn lies(&self, id: u64) -> bool {
        self.liar == Some(id) && self.chaos
    }

    fn tell_all(&mut self, id: u64, signed: &Signed) {
        let bytes = signed.to_bytes();
        for to in self.newest_members().nodes().into_iter().filter(|to| *to != id) {
            self.tell_one(id, to, bytes.clone());
        }
    }

    fn tell_one(&mut self, from: u64, to: u64, signed: Bytes) {
        if let Some(at) = self.links.statement(self.now, (from, to), &mut self.random.statements) {
            self.schedule_at(at, Happening::Statement { from, to, signed });
        }
    }

    /// A liar sends each member what it likes: the truth although it does not vote, another block, other results, one after the
    /// other, or something in the name of another.
    fn state_falsely(&mut self, id: u64, truth: Statement) -> Check {
        if !self.lies(id) {
            return Ok(());
        }
        let node = self.people.node(id, self.plan.organisations);
        let results = Statement { results: Hash::of(&[b"a lie"]), ..truth };
        let block = Statement { block: Hash::of(&[b"a lie"]), ..results };
        let all = [truth, results, block].map(|said| said.sign(id, node.certificate.clone(), &node.key).unwrap());
        let [truth, results, block] = all;
        for to in self.newest_members().nodes().into_iter().filter(|to| *to != id) {
            self.coverage.lies += 1;
            let said = match self.random.statements.below(5) {
                0 => vec![truth.clone()],
                1 => vec![results.clone()],
                2 => vec![block.clone()],
                3 => vec![truth.clone(), block.clone(), results.clone()],
                _ => {
                    let mut forged = truth.clone();
                    forged.signature.node = 1 + self.random.statements.below(self.plan.voters);
                    vec![forged]
                }
            };
            for signed in said {
                self.tell_one(id, to, signed.to_bytes());
            }
        }
        Ok(())
    }

    /// Does every member have a certificate for the newest block that is due, if its process has executed it?
    pub fn is_certified(&self) -> bool {
        let newest = self.blocks.iter().rev().find(|block| block.outcome.certifiable.is_some());
        let Some(newest) = newest.map(|block| block.outcome.header.height) else { return true };
        let members = self.newest_members();
        let certified = |id: &u64| {
            let stated = self.nodes.get(id).and_then(|node| node.up.as_ref()).is_some_and(|up| up.stated >= newest);
            !stated || self.invariants.certified.newest(*id) >= newest
        };
        members.voters.iter().chain(&members.learners).all(certified)
    }
}
