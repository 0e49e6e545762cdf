//! Messages between the parts, statements, evidence, and chains that are compared.

use super::copy::Copy;
use super::world::{ASK_EVERY, BEAT, Happening, Timer, World};
use crate::clock::SECOND;
use crate::invariant::{Check, Violation};
use bytes::Bytes;
use ledger::msp;
use ledger_base::rejection::Code;
use ledger_light::Signed;
use ledger_raft::{Evidence as SentEvidence, Input, PeerMessage, RaftKind, SignedStatement};
use ledger_replica::catch_up::{Holding, Who};
use ledger_replica::certifier;
use ledger_replica::company::{Follows, Place, Point, Said};
use ledger_replica::disputes::{self, View};
use std::sync::Arc;

/// Most statements in the record of a node.
const SIGNED_MAX: usize = 256;
/// Looks at the time until proofs are sent again.
const BEATS_AGAIN: u64 = 16;
/// For so long a node whose history most voters do not have looks for a certificate (`src/peers/chain_monitor.rs`).
const FORKED_PATIENCE: u64 = 10 * SECOND;

impl World {
    /// The copies that hear what this one sends to a number.
    pub(super) fn heard_by(&mut self, at: usize, to: u64) -> Vec<usize> {
        let part = |world: &Self, id: u64| world.parts.get(&id).copied().unwrap_or_default();
        let from = &self.copies[at];
        let (lies, face, own) = (from.lies, from.face, part(self, from.node.id));
        let eavesdrops = self.lying && !lies && self.random.percent(10);
        let hears = |copy: &Copy| match (lies, copy.lies) {
            (false, false) => !self.is_cut || part(self, copy.node.id) == own,
            (false, true) => copy.face == own || eavesdrops,
            (true, false) => part(self, copy.node.id) == face,
            (true, true) => copy.face == face,
        };
        let all = self.copies.iter().enumerate();
        all.filter(|(_, copy)| copy.node.id == to && !copy.gone && hears(copy)).map(|(at, _)| at).collect()
    }

    pub(super) fn send(&mut self, at: usize, to: u64, message: &PeerMessage) -> Check {
        if let PeerMessage::Raft(raft) = message {
            let (kind, id) = (raft.kind(), self.copies[at].node.id);
            match kind {
                RaftKind::VoteResponse if !raft.reject => {
                    self.judge.votes(id, raft.term, to)?;
                    self.voted(at);
                }
                RaftKind::Vote => self.judge.votes(id, raft.term, id)?,
                _ => {}
            }
            if !matches!(kind, RaftKind::Heartbeat | RaftKind::HeartbeatResponse) {
                let (term, index, entries, refused) = (raft.term, raft.index, raft.entries.len(), raft.reject);
                let label = self.label(at);
                self.note(format_args!(
                    "{label} > n{to} {kind:?} term {term} index {index} +{entries} refused {refused}"
                ));
            }
        }
        if let PeerMessage::Complaint(complaint) = message {
            self.note(format_args!("{} complains about n{} to n{to}", self.label(at), complaint.leader));
            let is_liar = self.copies.iter().any(|copy| copy.lies && copy.node.id == complaint.leader);
            if is_liar && !self.copies[at].lies {
                self.judge.counts.count("a voter complains about a withholding leader");
            }
        }
        let bytes = message.to_bytes();
        for target in self.heard_by(at, to) {
            if self.random.per_mille(self.plan.lose_per_mille) {
                continue;
            }
            let (from, delay) = (self.copies[at].node.id, self.random.between(100, self.plan.delay_max));
            self.schedule(delay, Happening::Deliver { from, to: target, bytes: bytes.clone() });
        }
        Ok(())
    }
    pub(super) fn send_all(&mut self, at: usize, message: &PeerMessage, except: u64) -> Check {
        let Some(up) = self.up(at) else { return Ok(()) };
        let (members, me) = (up.ledger.members().unwrap().nodes(), self.copies[at].node.id);
        members.into_iter().filter(|to| ![me, except].contains(to)).try_for_each(|to| self.send(at, to, message))
    }
    pub(super) fn deliver(&mut self, from: u64, at: usize, bytes: Bytes) -> Check {
        let now = self.now;
        let copy = &mut self.copies[at];
        let certified = copy.certified();
        let (certificates, Some(up)) = (&copy.certificates, &mut copy.up) else { return Ok(()) };
        let message = PeerMessage::decode(bytes).unwrap();
        let mut found = Vec::new();
        match message {
            PeerMessage::Statement(SignedStatement { signed }) => {
                let Ok(signed) = Signed::from_bytes(&signed) else { return Ok(()) };
                let certificate = |height| certificates.get(&height).cloned();
                let view = View { certifier: &up.certifier, certified, certificate: &certificate };
                up.disputes.heard(now, from, &signed, &view, &mut found);
                self.follow(at, found)?;
                self.certify(at, certifier::Event::Heard { from, signed })
            }
            PeerMessage::Evidence(SentEvidence { proof }) => {
                up.disputes.shown(from, &proof, &mut found);
                self.follow(at, found)
            }
            message if up.company.withholds(from, &message) => Ok(()),
            message => self.input(at, Input::Message { from, message }),
        }
    }

    pub(super) fn certify(&mut self, at: usize, event: certifier::Event) -> Check {
        let now = self.now;
        let Some(up) = self.up(at) else { return Ok(()) };
        let (mut effects, mut found) = (Vec::new(), Vec::new());
        let durable = up.store.durable_index();
        up.certifier.step(now, event, &mut effects);
        up.certifier.step(now, certifier::Event::Durable(durable), &mut effects);
        for effect in effects {
            let copy = &mut self.copies[at];
            let id = copy.node.id;
            match effect {
                certifier::Effect::Record(statement) => {
                    copy.node.signed.push_back(statement);
                    if copy.node.signed.len() > SIGNED_MAX {
                        copy.node.signed.pop_front();
                    }
                }
                certifier::Effect::Tell(signed) => {
                    self.judge.signs(id, &signed.statement)?;
                    self.tell(at, &signed)?;
                }
                certifier::Effect::Pass(signed) => self.tell(at, &signed)?,
                certifier::Effect::Certified { certificate, .. } => {
                    let height = certificate.statement.height;
                    copy.certificates.insert(height, certificate.clone());
                    self.control.certified(height, certificate.statement.block, now);
                    if !copy.lies {
                        self.judge.made(id, &certificate, self.lying)?;
                    }
                    let label = self.label(at);
                    self.note(format_args!("{label} certifies {height} {}", certificate.statement.block));
                }
                certifier::Effect::Misbehaved(proof) => {
                    if let Some(up) = self.up(at) {
                        up.disputes.found(*proof, &mut found);
                    }
                }
            }
        }
        let certified = self.copies[at].certified();
        if let Some(up) = self.up(at) {
            up.disputes.look(certified, &mut found).unwrap();
        }
        self.follow(at, found)
    }
    pub(super) fn tell(&mut self, at: usize, signed: &Signed) -> Check {
        let message = PeerMessage::Statement(SignedStatement { signed: signed.to_bytes() });
        self.send_all(at, &message, 0)
    }

    /// Does what follows from something that contradicts. A liar does not care.
    pub(super) fn follow(&mut self, at: usize, found: Vec<disputes::Effect>) -> Check {
        for effect in found {
            let (id, lies) = (self.copies[at].node.id, self.copies[at].lies);
            match effect {
                disputes::Effect::Pass(signed) => self.tell(at, &signed)?,
                _ if lies => {}
                disputes::Effect::Show { proof, except } => {
                    let message = PeerMessage::Evidence(SentEvidence { proof: proof.to_bytes() });
                    self.send_all(at, &message, except)?;
                }
                disputes::Effect::Keep(proof) => {
                    self.note(format_args!("{} proves that n{} has misbehaved", self.label(at), proof.node()));
                    self.judge.proves(id, &proof)?;
                }
                disputes::Effect::Exclude(liars) => self.input(at, Input::Exclude(liars))?,
                disputes::Effect::Diverged { height } => {
                    return Err(Violation::new(
                        "a node ends only for a reason",
                        format!("n{id} computed {height} twice"),
                    ));
                }
                disputes::Effect::Contradicted { branch, .. } => {
                    let own = &self.copies[at].certificates;
                    self.judge.contradicted(id, branch.certificate(), branch.height(), own)?;
                    self.end(at, Code::Contradicted);
                }
                disputes::Effect::TwoCertificates(branch) => {
                    self.note(format_args!("{} shows two certificates of {}", self.label(at), branch.height()));
                    if self.judge.is_binding() {
                        let what = format!("n{id} shows two certificates of block {}", branch.height());
                        return Err(Violation::new("no two certificates for one height", what));
                    }
                    self.judge.counts.count("two strict certificates where two organisations lie");
                }
                disputes::Effect::Refused { from, reason } => {
                    self.note(format_args!("{} refuses a proof of n{from}: {}", self.label(at), reason.code));
                }
            }
        }
        Ok(())
    }
    pub(super) fn beat(&mut self, at: usize) -> Check {
        self.schedule_timer(at, BEAT, Timer::Beat);
        self.certify(at, certifier::Event::Time)?;
        let Some(up) = self.up(at) else { return Ok(()) };
        up.beats += 1;
        if !up.beats.is_multiple_of(BEATS_AGAIN) {
            return Ok(());
        }
        let mut found = Vec::new();
        up.disputes.again(&mut found);
        self.follow(at, found)
    }
    /// A node compares its chain with those of the voters that it reaches (`src/peers/chain_monitor.rs`).
    pub(super) fn ask(&mut self, at: usize) -> Check {
        self.schedule_timer(at, ASK_EVERY, Timer::Ask);
        if self.copies[at].lies {
            return Ok(());
        }
        let Some(up) = self.up(at) else { return Ok(()) };
        let members = up.ledger.members().unwrap();
        let known = msp::nodes(&**up.ledger.state()).unwrap();
        let organisation = |id: &u64| known.iter().find(|node| node.id == *id).map(|node| node.organisation.clone());
        let voters = members.voters.iter().filter_map(|id| Some((*id, organisation(id)?)));
        let place = Place { voters: voters.collect(), members: members.nodes(), cut_off: false };
        let mut height = None;
        loop {
            let said = self.said_to(at, &place, height.unwrap_or(u64::MAX));
            self.ask_for_certificates(at, &said)?;
            let Some(up) = self.up(at) else { return Ok(()) };
            match up.company.heard(&said, &place, height).unwrap() {
                Follows::Ask(other) if height.is_none() => height = Some(other),
                Follows::Stop(reason) if reason.code == Code::Forked => {
                    let now = self.now;
                    let Some(up) = self.up(at) else { return Ok(()) };
                    let strict = up.ledger.voters().unwrap().rule.strict_since.is_some();
                    let since = *up.forked.get_or_insert(now);
                    if !strict || now - since > FORKED_PATIENCE {
                        self.end(at, Code::Forked);
                    }
                    return Ok(());
                }
                Follows::Stop(reason) => {
                    let what = format!("{}: {reason}", self.label(at));
                    return Err(Violation::new("a node ends only for a reason", what));
                }
                Follows::Nothing | Follows::Ask(_) | Follows::Fetch(_) => {
                    if let Some(up) = self.up(at) {
                        up.forked = None;
                    }
                    return Ok(());
                }
            }
        }
    }
    pub(super) fn said_to(&mut self, at: usize, place: &Place, height: u64) -> Vec<Said> {
        let me = self.copies[at].node.id;
        let own = self.copies[at].up.as_ref().and_then(|up| up.point(height)).map_or(0, |own| own.height);
        let mut said = Vec::new();
        for (id, organisation) in place.voters.iter().filter(|(id, _)| **id != me) {
            for target in self.heard_by(at, *id) {
                let copy = &self.copies[target];
                let Some(up) = &copy.up else { continue };
                let tip = up.ledger.tip().height;
                let has =
                    Holding { height: tip, durable: up.store.durable_index(), first_height: 1, ..Holding::default() };
                let who = Who { id: *id, organisation: organisation.clone(), name: copy.name.clone(), vouched: false };
                said.push(Said { who, has, at: up.point(own.min(height)), stranger: false });
                break;
            }
        }
        said
    }
    /// Asks those that have another block for the certificate that covers it.
    pub(super) fn ask_for_certificates(&mut self, at: usize, said: &[Said]) -> Check {
        let Some(up) = &self.copies[at].up else { return Ok(()) };
        let differs = |there: &Point| {
            up.point(there.height).is_some_and(|own| own.height == there.height && own.hash != there.hash)
        };
        let other = said.iter().filter_map(|one| Some((one.who.id, one.at.filter(differs)?.height)));
        // The log may contradict theirs behind what is executed here.
        let next = up.ledger.tip().height + 1;
        let asked: Vec<_> = other.chain(up.contradicting.iter().map(|id| (*id, next))).collect();
        for (id, height) in asked {
            let Some(target) = self.heard_by(at, id).into_iter().next() else { continue };
            let copy = &self.copies[target];
            let branch = copy.up.as_ref().and_then(|up| up.branch(height, &copy.certificates));
            let Some(branch) = branch else { continue };
            let (certified, mut found) = (self.copies[at].certified(), Vec::new());
            if let Some(up) = self.up(at) {
                let store = Arc::clone(&up.store);
                up.disputes.branch(branch, certified, |height| store.entry(height).ok().flatten(), &mut found);
            }
            self.follow(at, found)?;
        }
        Ok(())
    }
}
