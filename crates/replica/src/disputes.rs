//! Signatures that must not be: proofs of misbehaviour, and certificates of other blocks than this node has.
//!
//! The [certifier](crate::certifier) compares what voters state about its own blocks. Everything else that contradicts comes
//! here: statements about other blocks, proofs that peers send, the certified part of another branch. This machine checks
//! the signatures and decides what this node believes, sends on, and stops for:
//!
//! | what is found | what follows |
//! |---|---|
//! | a proof that a node has lied | it is kept and sent to all; nothing of that node is followed any more |
//! | a proof that this node has computed a block in two ways | it stops |
//! | a strict certificate of another block than this node has executed, or has in its log in the same term | it stops, unless its own strict certificate covers its block |
//! | two strict certificates of two blocks | both are shown; people decide |
//!
//! It has no thread, clock, disk or connection of its own.

mod branches;
mod evidence;

pub use evidence::Evidence;

use crate::certifier::{Certifier, Signing};
use branches::Branches;
use ledger::Ledger;
use ledger::branch::CertifiedBranch;
use ledger_base::hash::Hash;
use ledger_base::mutation::{Mutation, active};
use ledger_base::rejection::Rejection;
use ledger_light::{Certificate, Governance, Misbehaviour, Signed};
use ledger_storage::entry::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Most old statements that are remembered because the signatures of a certificate were sent for them.
const EXCHANGED_MAX: usize = 4096;
/// Most statements passed on by one peer in a second whose signatures are checked here.
const PASSED_MAX: u32 = 64;
/// The second in which they are counted, microseconds.
const PASSED_TIME: u64 = 1_000_000;

/// An effect: the node must do it. Losing what is sent is allowed.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Send this statement of another node to every member.
    Pass(Signed),
    /// Send this proof to every member but one.
    Show {
        /// The proof.
        proof: Box<Misbehaviour>,
        /// The member from which it has come, or this node.
        except: u64,
    },
    /// Keep this proof on the disk: it is new.
    Keep(Box<Misbehaviour>),
    /// These nodes have lied: the engine takes nothing from them any more ([`ledger_raft::Input::Exclude`]).
    Exclude(BTreeSet<u64>),
    /// This node has computed the block of this height in two ways: it stops.
    Diverged {
        /// The height.
        height: u64,
    },
    /// A strict certificate contradicts the chain of this node: it keeps the branch, and stops.
    Contradicted {
        /// The branch that is certified.
        branch: Box<CertifiedBranch>,
        /// The own block at the height where that begins.
        own: Hash,
    },
    /// A strict certificate of this node covers another block than this branch has: both are shown, and people decide.
    TwoCertificates(Box<CertifiedBranch>),
    /// A proof is not accepted. Nothing is to be done but to say so.
    Refused {
        /// The peer that has sent it.
        from: u64,
        /// Why.
        reason: Rejection,
    },
}

/// The knowledge of this node about its own blocks.
pub struct View<'a, S> {
    /// Its statements, and those about the same blocks.
    pub certifier: &'a Certifier<S>,
    /// The newest height for which it has a certificate; 0 if there is none.
    pub certified: u64,
    /// Its certificate of a height, if it is recent.
    pub certificate: &'a dyn Fn(u64) -> Option<Certificate>,
}

/// Judges what contradicts.
pub struct Disputes<S> {
    me: u64,
    ledger: Arc<Ledger>,
    /// The governance of the genesis.
    founded: Governance,
    /// Checks the signatures.
    signing: S,
    evidence: Arc<Evidence>,
    branches: Branches,
    /// Heights and nodes for whose statements the signatures of a certificate were sent.
    exchanged: BTreeSet<(u64, u64)>,
    /// Statements of others that each peer has passed on in the second that began then.
    passed: BTreeMap<u64, (u64, u32)>,
}

impl<S: Signing> Disputes<S> {
    /// Of this node, with the proofs that it has.
    pub fn new(me: u64, ledger: Arc<Ledger>, founded: Governance, signing: S, evidence: Arc<Evidence>) -> Self {
        let (branches, exchanged, passed) = Default::default();
        Self { me, ledger, founded, signing, evidence, branches, exchanged, passed }
    }

    /// A peer has sent a statement of a voter. To be told before the certifier hears of it. `now` is steadily growing time in
    /// microseconds.
    pub fn heard(&mut self, now: u64, from: u64, signed: &Signed, view: &View<'_, S>, out: &mut Vec<Effect>) {
        self.compare(signed, view, out);
        self.hear_of_branch(now, from, signed, view);
    }

    /// A peer has sent a proof of misbehaviour. It counts if the organisations that this node knows say so.
    pub fn shown(&mut self, from: u64, proof: &[u8], out: &mut Vec<Effect>) {
        match Misbehaviour::from_bytes(proof).and_then(|proof| self.checked(proof)) {
            Ok(proof) => self.misbehaved(proof, from, out),
            Err(reason) => out.push(Effect::Refused { from, reason }),
        }
    }

    fn checked(&self, proof: Misbehaviour) -> Result<Misbehaviour, Rejection> {
        if !self.evidence.has(&proof) && !active(Mutation::BelieveAnyProof) {
            let msps = self.ledger.msps();
            let identify = |der: &[u8], time: u64| self.signing.identify(&msps, der, time);
            proof.verify(&self.ledger.network(), &self.ledger.voters()?.nodes, identify)?;
        }
        Ok(proof)
    }

    /// A part of this node has found a proof.
    pub fn found(&mut self, proof: Misbehaviour, out: &mut Vec<Effect>) {
        self.misbehaved(proof, self.me, out);
    }

    fn misbehaved(&mut self, proof: Misbehaviour, from: u64, out: &mut Vec<Effect>) {
        if !self.evidence.add(&proof) {
            return;
        }
        let proof = Box::new(proof);
        out.push(Effect::Keep(proof.clone()));
        if !active(Mutation::KeepAProofForItself) {
            out.push(Effect::Show { proof: proof.clone(), except: from });
        }
        if !active(Mutation::FollowALiar) {
            out.push(Effect::Exclude(self.evidence.liars()));
        }
        if let Misbehaviour::Fault(fault) = &*proof
            && proof.node() == self.me
        {
            out.push(Effect::Diverged { height: fault.first.statement.height });
        }
    }

    /// From time to time: a member may have been away, or the engine may have had no room.
    pub fn again(&self, out: &mut Vec<Effect>) {
        if active(Mutation::FollowALiar) {
            return;
        }
        out.push(Effect::Exclude(self.evidence.liars()));
        if active(Mutation::KeepAProofForItself) {
            return;
        }
        let members = self.ledger.members().unwrap_or_default().nodes();
        let about_members = self.evidence.proofs().into_iter().filter(|proof| members.contains(&proof.node()));
        out.extend(about_members.map(|proof| Effect::Show { proof: Box::new(proof), except: self.me }));
    }

    /// Looks whether voters have certified another block than this node has executed.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn look(&mut self, certified: u64, out: &mut Vec<Effect>) -> Result<(), Rejection> {
        let ledger = Arc::clone(&self.ledger);
        let own = |height| Ok(ledger.block_hashes(height)?.map(|own| own.hash));
        for certificate in self.branches.contradicting(ledger.tip().height, own)? {
            self.branch(CertifiedBranch::of(certificate), certified, |_| None, out);
        }
        Ok(())
    }

    /// Does the certificate of a branch contradict this node? Then it stops, unless a strict certificate of its own covers its
    /// block: then both are shown, and people decide. `log` is the entry of this node's log at a height, executed or not.
    pub fn branch(
        &self,
        branch: CertifiedBranch,
        certified: u64,
        log: impl Fn(u64) -> Option<Entry>,
        out: &mut Vec<Effect>,
    ) {
        match self.contradicts(&branch, certified, log) {
            Ok(Some(Against::Chain { branch, own })) => {
                out.push(Effect::Contradicted { branch: Box::new(branch), own })
            }
            Ok(Some(Against::Certificate)) => out.push(Effect::TwoCertificates(Box::new(branch))),
            Ok(None) => {}
            Err(reason) => {
                tracing::debug!(height = branch.height(), code = reason.code.name(), %reason, "certificate of another \
                                                                                               branch rejected");
            }
        }
    }

    fn contradicts(
        &self,
        branch: &CertifiedBranch,
        certified: u64,
        log: impl Fn(u64) -> Option<Entry>,
    ) -> Result<Option<Against>, Rejection> {
        let (height, tip) = (branch.height(), self.ledger.tip());
        let executed = self.ledger.block_hashes(height)?.map(|own| own.hash);
        let found = match executed {
            Some(own) => (own != branch.block()).then(|| (branch.clone(), own)),
            // What this node has not executed is in its log: a liar may have given it another entry in the same term.
            None => branch.against_log(&tip, log),
        };
        let Some((branch, own)) = found else { return Ok(None) };
        let common = self.governance(certified.min(height.saturating_sub(1)))?;
        if !active(Mutation::StopForAnyCertificate) {
            common.check_strict(branch.certificate())?;
        }
        let is_strict = self.governance(certified)?.certificate_rule()?.strict_since.is_some();
        let is_covered = certified >= height && is_strict && !active(Mutation::DropACertifiedBlock);
        Ok(Some(if is_covered { Against::Certificate } else { Against::Chain { branch, own } }))
    }

    /// The governance after the own block at a height.
    fn governance(&self, height: u64) -> Result<Governance, Rejection> {
        self.founded.as_of(height, &self.ledger.changes(0, usize::MAX)?)
    }

    /// A node has signed something else about a block than this node's certificate says: the signatures in the certificate
    /// are sent for it. A block that the certifier still holds is its own matter.
    fn compare(&mut self, signed: &Signed, view: &View<'_, S>, out: &mut Vec<Effect>) {
        let (height, node) = (signed.statement.height, signed.signature.node);
        if view.certifier.holds(height) || self.exchanged.contains(&(height, node)) {
            return;
        }
        let own = (view.certificate)(height).filter(|own| own.statement != signed.statement);
        let Some(Certificate { statement, signatures }) = own.filter(|_| self.check(signed).is_ok()) else { return };
        self.exchanged.insert((height, node));
        if self.exchanged.len() > EXCHANGED_MAX {
            self.exchanged.pop_first();
        }
        for signature in signatures {
            let other = Signed { statement, signature };
            out.push(Effect::Pass(other.clone()));
            if let Some(proof) = Misbehaviour::of(other, signed.clone()) {
                self.found(proof, out);
            }
        }
    }

    fn check(&self, signed: &Signed) -> Result<(), Rejection> {
        let Signed { statement, signature } = signed;
        let identity = self.signing.identify(&self.ledger.msps(), &signature.certificate, statement.time)?;
        self.ledger.voters()?.check(statement, signature, &identity)
    }

    /// A voter has signed something about a block, which this node does not have, or has not executed yet.
    fn hear_of_branch(&mut self, now: u64, from: u64, signed: &Signed, view: &View<'_, S>) {
        let (statement, node) = (&signed.statement, signed.signature.node);
        if statement.network != self.ledger.network() || node == self.me || view.certifier.agrees_with(statement) {
            return;
        }
        let differs = match self.ledger.block_hashes(statement.height) {
            Ok(own) => own.map_or(statement.height > self.ledger.tip().height, |own| own.hash != statement.block),
            Err(_) => false,
        };
        if differs && (node == from || (self.may_pass(now, from) && self.check(signed).is_ok())) {
            self.branches.heard(signed.clone());
        }
    }

    fn may_pass(&mut self, now: u64, peer: u64) -> bool {
        self.passed.retain(|_, (begun, _)| now.saturating_sub(*begun) < PASSED_TIME);
        let (_, count) = self.passed.entry(peer).or_insert((now, 0));
        *count = count.saturating_add(1);
        *count <= PASSED_MAX
    }
}

/// The thing that the certificate of another branch contradicts.
enum Against {
    /// Blocks without a strict certificate.
    Chain {
        /// The branch, from the first block that this node has otherwise.
        branch: CertifiedBranch,
        /// The own block there.
        own: Hash,
    },
    /// A strict certificate of this node.
    Certificate,
}
