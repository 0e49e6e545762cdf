//! The last act: people remove the voters that are proved to have lied, by the proof (`ledgerctl network remove --proof`), without
//! their organisation; the others order on.

use super::copy::Up;
use super::world::World;
use crate::clock::SECOND;
use crate::invariant::{Check, Violation};
use ledger::msp::{NodeRole, SetNodeRole};
use ledger_raft::{Input, Lane};
use std::collections::BTreeMap;

/// The admins sign again after this time.
const AGAIN_AFTER: u64 = SECOND;
/// Afterwards the removal must be executed.
const REMOVAL_MAX: u64 = 60 * SECOND;

impl World {
    /// Removes each voter whose lie an honest node can prove, where the others can order without it.
    ///
    /// # Errors
    /// The removal is not executed, though most voters serve.
    pub(super) fn remove_liars(&mut self) -> Check {
        let proofs = self.proofs();
        if proofs.is_empty() || !self.judge.serves {
            return Ok(());
        }
        // With fewer voters other rules hold for certificates.
        self.judge.retire();
        let deadline = self.now + REMOVAL_MAX;
        loop {
            let left: BTreeMap<u64, String> = proofs
                .iter()
                .filter(|(node, _)| self.is_voter(**node))
                .map(|(node, proof)| (*node, proof.clone()))
                .collect();
            if left.is_empty() {
                self.judge.counts.count("a voter is removed by the proof of its lie");
                return Ok(());
            }
            if self.now >= deadline {
                let what = format!("{:?} are voters still; {}", left.keys(), self.describe());
                return Err(Violation::new("a proved liar loses its vote without its organisation", what));
            }
            for (node, proof) in left {
                self.order_removal(node, &proof)?;
            }
            self.run_until(self.now + AGAIN_AFTER)?;
        }
    }

    /// The proofs of lies that honest nodes have, by node.
    fn proofs(&self) -> BTreeMap<u64, String> {
        let honest = self.copies.iter().filter(|copy| !copy.lies && copy.up.is_some());
        let proofs = honest.flat_map(|copy| copy.evidence.proofs()).filter(|proof| proof.is_lie());
        proofs
            .map(|proof| (proof.node(), hex::encode(proof.to_bytes())))
            .filter(|(node, _)| self.is_voter(*node))
            .collect()
    }

    /// Is it to vote, as most honest nodes have it?
    fn is_voter(&self, node: u64) -> bool {
        let newest = self.honest().max_by_key(|up| up.ledger.tip().height);
        let records = newest.map(|up| ledger::msp::nodes(&**up.ledger.state()).unwrap()).unwrap_or_default();
        records.iter().any(|record| record.id == node && record.role == NodeRole::Voter)
    }

    fn honest(&self) -> impl Iterator<Item = &Up> {
        self.copies.iter().filter(|copy| !copy.lies).filter_map(|copy| copy.up.as_ref())
    }

    /// An admin of each honest organisation that has a node signs the same call.
    fn order_removal(&mut self, node: u64, proof: &str) -> Check {
        let set = SetNodeRole {
            id: Some(node),
            organisation: None,
            name: None,
            role: NodeRole::Removed,
            proof: Some(proof.to_owned()),
        };
        let call = serde_json::to_vec(&set).unwrap();
        for place in 0..self.plan.shape.len() {
            let at = (0..self.copies.len()).find(|at| !self.copies[*at].lies && self.copies[*at].up.is_some());
            let Some(at) = at.filter(|_| !self.plan.lies(place)) else { continue };
            let admin = format!("Org{}/admin", place + 1);
            let signed = self.sign_as(0, &admin, ("msp", "set_node_role", vec![call.clone().into()]));
            self.input(at, Input::Submit { lane: Lane::Control, transaction: signed.encoded().clone() })?;
        }
        Ok(())
    }
}
