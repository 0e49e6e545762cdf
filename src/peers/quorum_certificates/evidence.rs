//! Proofs of misbehaviour in words, for operators.

use super::kept::{Kind, ProofName};
use crate::ordering::directory::Directory;
use ledger_light::Misbehaviour;
use ledger_replica::disputes::Evidence;
use std::collections::BTreeSet;

/// The members that have lied; empty if none has. A former number is no member.
pub(super) fn lies(evidence: &Evidence, directory: &Directory) -> String {
    described(evidence, directory, Misbehaviour::is_lie)
}

/// The members that have signed different results of one block; empty if there are none.
pub(super) fn faults(evidence: &Evidence, directory: &Directory) -> String {
    described(evidence, directory, |proof| !proof.is_lie())
}

fn described(evidence: &Evidence, directory: &Directory, of: impl Fn(&Misbehaviour) -> bool) -> String {
    let members: BTreeSet<u64> = directory.members().iter().map(|member| member.id).collect();
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
    let proofs = evidence.proofs();
    let described: Vec<_> =
        proofs.iter().filter(|proof| members.contains(&proof.node()) && of(proof)).map(words).collect();
    described.join(", ")
}
