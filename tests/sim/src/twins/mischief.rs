//! The deeds of liars beyond running twice, and the other faults while they lie.

use super::copy::Copy;
use super::world::{Happening, World};
use crate::clock::{MILLISECOND, SECOND};
use crate::invariant::{Check, Violation};
use crate::withholding::withhold;
use bytes::Bytes;
use ledger::branch::CertifiedBranch;
use ledger_base::hash::Hash;
use ledger_light::{Certificate, Complaint, DoubleVote, Misbehaviour, Signature, Statement, Vote};
use ledger_raft::{
    Evidence, Input, Lane, Mandate, PeerMessage, RaftKind, RaftMessage, SignedComplaint, SignedStatement,
};
use ledger_replica::Event;

/// The name of a transfer of leadership in a request for a vote.
const TRANSFER: &[u8] = b"CampaignTransfer";

impl World {
    /// The liars' nodes run twice from now on, each copy with a copy of the disk, and tell two stories.
    pub(super) fn begin_to_lie(&mut self) -> Check {
        self.lying = true;
        self.schedule(0, Happening::Forge);
        if self.plan.calm {
            return self.begin_calmly();
        }
        let liars: Vec<usize> = (0..self.copies.len()).filter(|at| self.copies[*at].lies).collect();
        for at in liars {
            self.stop(at, false);
            let seed = self.random.number();
            let (original, second) = (self.copies[at].node.id, self.copies.len());
            let node = self.copies[at].node.copied(seed);
            self.note(format_args!("n{original} runs twice"));
            let copy = &self.copies[at];
            let twin = Copy {
                node,
                name: copy.name.clone(),
                face: 1,
                lies: true,
                gone: false,
                ended: None,
                evidence: Default::default(),
                certificates: copy.certificates.clone(),
                joins: None,
                up: None,
            };
            self.copies.push(twin);
            for at in [at, second] {
                let delay = self.random.between(1, 500) * MILLISECOND;
                self.schedule(delay, Happening::Start { at });
            }
        }
        if self.plan.crashes {
            self.schedule(SECOND, Happening::Crash);
        }
        self.change_parts()
    }

    /// Where nothing else goes wrong, an honest leader stays whatever liars send; or a liar leads, who withholds.
    fn begin_calmly(&mut self) -> Check {
        let leader =
            (0..self.copies.len()).find(|at| self.copies[*at].up.as_ref().is_some_and(|up| up.replica.leads()));
        let Some(leader) = leader else {
            return Err(Violation::new("a calm network has a leader", self.describe()));
        };
        let liar = self.copies.iter().find(|copy| copy.lies).map(|copy| copy.node.id).unwrap_or_default();
        if self.plan.withholds && !self.copies[leader].lies {
            return self.input(leader, Input::TransferLeadership { to: liar });
        }
        let (id, lies) = (self.copies[leader].node.id, self.copies[leader].lies);
        let term = self.copies[leader].up.as_ref().map_or(0, |up| up.replica.status().role.term);
        self.reign = (!lies).then_some((term, id));
        Ok(())
    }

    /// A liar is to lead before it begins to lie.
    pub(super) fn lead(&mut self) -> Check {
        let leads = |copy: &Copy| copy.up.as_ref().is_some_and(|up| up.replica.leads());
        let Some(leader) = self.copies.iter().position(leads) else { return Ok(()) };
        let liar = self.copies.iter().find(|copy| copy.lies).map(|copy| copy.node.id).unwrap_or_default();
        match self.copies[leader].lies || self.random.percent(40) {
            true => Ok(()),
            false => self.input(leader, Input::TransferLeadership { to: liar }),
        }
    }

    /// A node has another leader: in a calm network an honest one is not deposed.
    pub(super) fn keeps_its_leader(&mut self, at: usize, term: u64, leader: Option<u64>) -> Check {
        match self.reign {
            Some((reign, of)) if self.lying && (term, leader) != (reign, Some(of)) => {
                let what = format!("{}: term {term}, leader {leader:?}, and n{of} leads in {reign}", self.label(at));
                Err(Violation::new("nobody deposes an honest leader that others reach", what))
            }
            _ => Ok(()),
        }
    }

    /// Honest nodes meet the other story.
    pub(super) fn change_parts(&mut self) -> Check {
        if !self.lying || self.plan.calm {
            return Ok(());
        }
        let honest: Vec<u64> = self.copies.iter().filter(|copy| !copy.lies).map(|copy| copy.node.id).collect();
        for id in honest {
            if self.parts.is_empty() || self.random.percent(50) {
                let part = self.random.below(2) as usize;
                self.parts.insert(id, part);
            }
        }
        self.is_cut = self.plan.cuts && self.random.percent(80);
        let (parts, cut) = (self.parts.clone(), self.is_cut);
        self.note(format_args!("parts {parts:?}, cut {cut}"));
        // Two copies that stand for election at once may lead in one term.
        if self.random.percent(60) {
            let liars = (0..self.copies.len()).filter(|at| self.copies[*at].lies);
            for at in liars.collect::<Vec<_>>() {
                self.input(at, Input::Campaign)?;
            }
        }
        let next = self.random.around(self.plan.between_parts);
        self.schedule(next, Happening::Parts);
        Ok(())
    }

    /// An honest node loses its power, and comes back.
    pub(super) fn crash(&mut self) -> Check {
        if !self.lying {
            return Ok(());
        }
        let up = |at: &usize| !self.copies[*at].lies && self.copies[*at].up.is_some();
        let honest: Vec<usize> = (0..self.copies.len()).filter(up).collect();
        if let Some(at) = self.random.pick(&honest).copied() {
            let power_fails = self.random.percent(70);
            self.stop(at, power_fails);
            self.judge.counts.count("an honest node crashes");
            let delay = self.random.between(10, 3_000) * MILLISECOND;
            self.schedule(delay, Happening::Start { at });
        }
        let next = self.random.between(1, 6) * SECOND;
        self.schedule(next, Happening::Crash);
        Ok(())
    }

    /// A node has voted: sometimes its power fails soon, and it is asked again in the same term.
    pub(super) fn voted(&mut self, at: usize) {
        if self.lying && self.plan.crashes && !self.copies[at].lies && self.votes.percent(20) {
            let delay = self.votes.between(1, 20) * MILLISECOND;
            self.schedule(delay, Happening::FailsAfterVote { at });
        }
    }

    pub(super) fn fail_power(&mut self, at: usize) -> Check {
        if self.lying && self.copies[at].up.is_some() {
            self.stop(at, true);
            self.judge.counts.count("the power of a voter fails after its vote");
            let delay = self.votes.between(5, 100) * MILLISECOND;
            self.schedule(delay, Happening::Start { at });
        }
        Ok(())
    }

    /// A liar that leads takes control calls, and orders other things.
    pub(super) fn withholds(&mut self, at: usize, event: &mut Event) -> bool {
        let copy = &self.copies[at];
        if !self.plan.withholds || !copy.lies || !self.lying {
            return false;
        }
        if !copy.up.as_ref().is_some_and(|up| up.replica.leads()) {
            return false;
        }
        let (is_gone, is_less) = withhold(event);
        if is_less {
            self.judge.counts.count("a control call is withheld");
        }
        is_gone
    }

    /// A liar sends something that no rule of the product makes.
    pub(super) fn forge(&mut self) -> Check {
        if !self.lying {
            return Ok(());
        }
        let next = self.random.around(self.plan.between_forged);
        self.schedule(next, Happening::Forge);
        let running = |lies: bool| move |copy: &(usize, &Copy)| copy.1.lies == lies && copy.1.up.is_some();
        let liars: Vec<usize> = self.copies.iter().enumerate().filter(running(true)).map(|(at, _)| at).collect();
        let honest: Vec<usize> = self.copies.iter().enumerate().filter(running(false)).map(|(at, _)| at).collect();
        let (Some(liar), Some(victim)) = (self.random.pick(&liars).copied(), self.random.pick(&honest).copied()) else {
            return Ok(());
        };
        self.judge.counts.count("something forged is sent");
        match self.random.below(16) {
            0 | 1 => return self.show_forged_branch(liar, victim),
            2 => return self.demote(victim),
            _ => {}
        }
        let Some(message) = self.forged(liar, victim) else { return Ok(()) };
        let (label, to) = (self.label(liar), self.copies[victim].node.id);
        self.note(format_args!("{label} sends n{to} {message:?}"));
        self.send_forged(liar, to, &message)
    }

    /// The admin of a liar takes the vote of an own node, so that certificates would not be strict any more.
    fn demote(&mut self, at: usize) -> Check {
        let liar = self.plan.liars.first().copied().unwrap_or_default();
        let own = self.copies.iter().find(|copy| copy.name.starts_with(&format!("Org{}/", liar + 1)));
        let Some(node) =
            own.map(|copy| copy.node.id).filter(|_| self.judge.strict && self.plan.ends_strict_without_one_of(liar))
        else {
            return Ok(());
        };
        let wish = format!(r#"{{"id":{node},"role":"learner"}}"#);
        let call = ("msp", "set_node_role", vec![wish.into()]);
        let transaction = self.sign_as(0, &format!("Org{}/admin", liar + 1), call);
        self.judge.counts.count("a liar would end strict certificates");
        self.input(at, Input::Submit { lane: Lane::Control, transaction: transaction.encoded().clone() })
    }

    fn send_forged(&mut self, liar: usize, to: u64, message: &PeerMessage) -> Check {
        let (from, bytes) = (self.copies[liar].node.id, message.to_bytes());
        for target in self.heard_by(liar, to) {
            let delay = self.random.between(100, self.plan.delay_max);
            self.schedule(delay, Happening::Deliver { from, to: target, bytes: bytes.clone() });
        }
        Ok(())
    }

    fn forged(&mut self, liar: usize, victim: usize) -> Option<PeerMessage> {
        let me = self.copies[liar].node.id;
        let role = self.copies[victim].up.as_ref()?.replica.status();
        let (term, leader) = (role.role.term.max(1), role.role.leader);
        let raft = |kind: RaftKind| RaftMessage { kind: kind.into(), term, ..RaftMessage::default() };
        let person = self.cast.person(&self.copies[liar].name);
        let (certificate, network) = (person.certificate.clone(), self.network);
        Some(match self.random.below(8) {
            // To have leadership at will.
            0 => PeerMessage::Raft(RaftMessage {
                term: term + 1,
                index: u64::MAX >> 2,
                log_term: term + 1,
                context: Bytes::from_static(TRANSFER),
                ..raft(RaftKind::Vote)
            }),
            1 => {
                let leader = leader.filter(|leader| *leader != me)?;
                let complaint = Complaint { network, recoveries: 0, term, leader, node: me };
                let signed = complaint.sign(certificate, &person.key).unwrap().to_bytes();
                PeerMessage::Complaint(SignedComplaint { term, leader, signed })
            }
            2 => PeerMessage::Evidence(Evidence { proof: self.forged_proof(liar, victim)?.to_bytes() }),
            // It has what it has not, or another log.
            3 => {
                let index = self.random.between(1, role.last.max(1));
                let hash = Bytes::copy_from_slice(&Hash::of(&[&self.random.number().to_be_bytes()]).0);
                PeerMessage::Raft(RaftMessage { index, hash, ..raft(RaftKind::AppendResponse) })
            }
            4 => PeerMessage::Raft(raft(RaftKind::TimeoutNow)),
            5 => PeerMessage::Raft(RaftMessage { term: term + 1, commit: role.last + 1, ..raft(RaftKind::Heartbeat) }),
            6 => PeerMessage::Mandate(Mandate { term: term + 1, votes: Vec::new() }),
            // In the name of another.
            _ => {
                let (height, time) = (role.commit.max(1), self.now);
                let (block, results) = (Hash::of(&[b"a lie"]), Hash::of(&[b"another"]));
                let statement = Statement { network, recoveries: 0, height, time, block, results };
                let other = self.copies.iter().find(|copy| !copy.lies && copy.node.id != me)?.node.id;
                let signed = statement.sign(other, certificate, &person.key).unwrap();
                PeerMessage::Statement(SignedStatement { signed: signed.to_bytes() })
            }
        })
    }

    /// A proof that an honest node has lied, signed by the liar.
    fn forged_proof(&mut self, liar: usize, victim: usize) -> Option<Misbehaviour> {
        let honest: Vec<u64> = self.copies.iter().filter(|copy| !copy.lies).map(|copy| copy.node.id).collect();
        let about = *self.random.pick(&honest)?;
        let (person, network) = (self.cast.person(&self.copies[liar].name), self.network);
        let (certificate, time) = (person.certificate.clone(), self.now);
        if self.random.percent(50) {
            let term = 1 + self.random.below(5);
            let vote = |candidate| {
                let vote = Vote { network, recoveries: 0, term, candidate, voter: about };
                let signed = vote.sign(certificate.clone(), &person.key).unwrap();
                (candidate, Signature { node: about, ..signed })
            };
            let votes = [vote(1), vote(2)];
            return Some(Misbehaviour::DoubleVote(DoubleVote { network, recoveries: 0, term, time, votes }));
        }
        let height = self.copies[victim].up.as_ref()?.ledger.tip().height.max(1);
        let say = |block: &[u8]| {
            let (block, results) = (Hash::of(&[block]), Hash::ZERO);
            let statement = Statement { network, recoveries: 0, height, time, block, results };
            statement.sign(about, certificate.clone(), &person.key).unwrap()
        };
        Misbehaviour::of(say(b"one"), say(b"other"))
    }

    /// A liar answers a question with a certificate that only its own hand has signed.
    fn show_forged_branch(&mut self, liar: usize, victim: usize) -> Check {
        let Some(up) = &self.copies[victim].up else { return Ok(()) };
        let tip = up.ledger.tip();
        if tip.height == 0 {
            return Ok(());
        }
        let (block, results) = (Hash::of(&[b"a branch"]), Hash::ZERO);
        let statement =
            Statement { network: self.network, recoveries: 0, height: tip.height, time: tip.time, block, results };
        let organisation = |name: &str| name.split('/').next().map(str::to_owned);
        let own = organisation(&self.copies[liar].name);
        let accomplices =
            self.copies.iter().filter(|copy| copy.lies && organisation(&copy.name) == own && copy.face == 0);
        let signatures = accomplices.map(|copy| {
            let person = self.cast.person(&copy.name);
            statement.sign(copy.node.id, person.certificate.clone(), &person.key).unwrap().signature
        });
        let certificate = Certificate { statement, signatures: signatures.collect() };
        let branch = CertifiedBranch::of(certificate);
        let label = self.label(liar);
        self.note(format_args!("{label} shows a forged branch of height {}", branch.height()));
        let (certified, mut found) = (self.copies[victim].certified(), Vec::new());
        if let Some(up) = self.up(victim) {
            up.disputes.branch(branch, certified, |_| None, &mut found);
        }
        self.follow(victim, found)
    }
}
