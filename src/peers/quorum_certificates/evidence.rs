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
            Kind::Lie => format!("{name} signed two different blocks of height {place}"),
            Kind::DoubleVote => format!("{name} voted for two nodes in term {place}"),
            Kind::DoubleHead => format!("{name} led with two different logs in term {place}"),
            Kind::Fault => format!("{name} signed two different results of block {place}"),
        }
    };
    let proofs = evidence.proofs();
    let described: Vec<_> =
        proofs.iter().filter(|proof| members.contains(&proof.node()) && of(proof)).map(words).collect();
    described.join(", ")
}

/// Says that there is a new proof.
pub(super) fn log(proof: &Misbehaviour, directory: &Directory) {
    let node = directory.name(proof.node());
    match proof {
        Misbehaviour::Lie(lie) => {
            let (height, first, second) =
                (lie.first.statement.height, lie.first.statement.block, lie.second.statement.block);
            tracing::error!(node, height, %first, %second, "a node signed two different blocks of one height; proof \
                                                            stored");
        }
        Misbehaviour::DoubleVote(votes) => {
            let [first, second] = votes.votes.each_ref().map(|(to, _)| directory.name(*to));
            tracing::error!(
                node,
                term = votes.term,
                first,
                second,
                "a voter voted for two nodes in one term; proof stored"
            );
        }
        Misbehaviour::DoubleHead(heads) => {
            let [first, second] = heads.branches.each_ref().map(|branch| branch.base);
            tracing::error!(
                node, term = heads.term, height = heads.height, %first, %second,
                "a leader signed two different logs in one term; proof stored"
            );
        }
        Misbehaviour::Fault(fault) => {
            let (height, first, second) =
                (fault.first.statement.height, fault.first.statement.results, fault.second.statement.results);
            tracing::error!(node, height, %first, %second, "a node signed two different results of one block; proof \
                                                            stored");
        }
    }
}
