//! The proofs of misbehaviour that this node has: one of each kind of a node, shown to operators and sent to every member.

use super::kept::{Kind, ProofName};
use crate::ordering::directory::Directory;
use ledger::branch::CertifiedBranch;
use ledger_light::Misbehaviour;
use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The proofs in memory.
pub(super) struct Evidence {
    proofs: Mutex<Vec<Misbehaviour>>,
    /// Two strict certificates that contradict each other, in words; empty if there are none.
    other: Mutex<String>,
}

impl Evidence {
    /// Those that the disk holds.
    pub(super) fn new(proofs: Vec<Misbehaviour>, other: Option<&CertifiedBranch>) -> Self {
        Self { proofs: Mutex::new(proofs), other: Mutex::new(other.map(two_certificates).unwrap_or_default()) }
    }

    /// Keeps that a strict certificate contradicts one of this node; false if there was one before.
    pub(super) fn set_other(&self, branch: &CertifiedBranch) -> bool {
        let mut other = self.other.lock().unwrap_or_else(PoisonError::into_inner);
        let is_first = other.is_empty();
        if is_first {
            *other = two_certificates(branch);
        }
        is_first
    }

    /// Two strict certificates that contradict each other, in words; empty if there are none.
    pub(super) fn other(&self) -> String {
        self.other.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Is there a proof that says as much?
    pub(super) fn has(&self, proof: &Misbehaviour) -> bool {
        let name = ProofName::from(proof);
        self.lock().iter().any(|known| ProofName::from(known).says_as_much_as(name))
    }

    /// Keeps a proof; false if there was one that says as much.
    pub(super) fn add(&self, proof: &Misbehaviour) -> bool {
        let mut proofs = self.lock();
        let name = ProofName::from(proof);
        let is_new = !proofs.iter().any(|known| ProofName::from(known).says_as_much_as(name));
        proofs.extend(is_new.then(|| proof.clone()));
        is_new
    }

    /// The nodes that have lied. A fault is no lie.
    pub(super) fn liars(&self) -> BTreeSet<u64> {
        self.lock().iter().filter(|proof| proof.is_lie()).map(Misbehaviour::node).collect()
    }

    /// The proofs about members, for other members.
    pub(super) fn about_members(&self, directory: &Directory) -> Vec<Misbehaviour> {
        let members: BTreeSet<u64> = directory.members().iter().map(|member| member.id).collect();
        self.lock().iter().filter(|proof| members.contains(&proof.node())).cloned().collect()
    }

    /// The members that have lied, in words; empty if none has. A former number is no member.
    pub(super) fn lies(&self, directory: &Directory) -> String {
        self.described(directory, |proof| proof.is_lie())
    }

    /// The members that have signed different results of one block, in words; empty if there are none.
    pub(super) fn faults(&self, directory: &Directory) -> String {
        self.described(directory, |proof| !proof.is_lie())
    }

    fn described(&self, directory: &Directory, of: impl Fn(&Misbehaviour) -> bool) -> String {
        let words = |proof: &Misbehaviour| {
            let ProofName { place, node, kind } = proof.into();
            let name = directory.name(node);
            match kind {
                Kind::Lie => format!("{name} has signed two different blocks of height {place}"),
                Kind::DoubleVote => format!("{name} has voted for two nodes in term {place}"),
                Kind::DoubleHead => format!("{name} has led with two different logs in term {place}"),
                Kind::Fault => format!("{name} has signed two different results of block {place}"),
            }
        };
        let described: Vec<_> = self.about_members(directory).iter().filter(|proof| of(proof)).map(words).collect();
        described.join(", ")
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Misbehaviour>> {
        self.proofs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn two_certificates(branch: &CertifiedBranch) -> String {
    format!(
        "voters have certified two blocks of height {}, this node's own and {}: people must decide",
        branch.height(),
        branch.block()
    )
}
