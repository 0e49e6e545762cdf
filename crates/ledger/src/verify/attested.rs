//! The attestations of nodes about the chain, compared with the outcome of its blocks.

use crate::chain::Outcome;
use crate::msp::{self, Attest, Attestation};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::result::Event;
use ledger_storage::state::Tip;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// How many blocks back an attestation is compared; nodes attest within seconds.
const HEIGHTS_MAX: usize = 100_000;

/// Most differences that are told one by one.
const DISSENTS_MAX: usize = 100;

/// A node signed something else than these blocks give.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Dissent {
    /// Height that it attested.
    pub height: u64,
    /// The node, e.g. `Org2/node3`.
    pub node: String,
    /// Block hash that it signed.
    pub hash: Hash,
    /// State digest that it signed.
    pub digest: Hash,
}

/// The computed chain, and who signed what about it.
#[derive(Default)]
pub(super) struct Attested {
    heights: BTreeMap<u64, Height>,
    /// The highest height at which each node agrees. It agrees with all below then: block hashes and state digests
    /// cover those before them.
    agreed: BTreeMap<String, u64>,
    /// The snapshot that the chain was begun from: height and content.
    snapshot: Option<(u64, Hash)>,
    /// Attestations that agree.
    pub(super) agreeing: u64,
    pub(super) dissents: Vec<Dissent>,
    /// Nodes that attested the snapshot which the chain was begun from.
    pub(super) snapshot_attested_by: BTreeSet<String>,
}

struct Height {
    hash: Hash,
    digest: Hash,
    agreeing: BTreeSet<String>,
    dissenting: BTreeSet<String>,
}

impl Attested {
    /// The chain begins with the state of a snapshot.
    pub(super) fn begin(&mut self, height: u64, content: Hash) {
        self.snapshot = Some((height, content));
    }

    /// Notes what the blocks give.
    ///
    /// # Errors
    /// As [`finish`](Self::finish), for what is too long ago to be attested still.
    pub(super) fn computed(&mut self, tip: &Tip) -> Result<(), Rejection> {
        let (agreeing, dissenting) = Default::default();
        self.heights.insert(tip.height, Height { hash: tip.hash, digest: tip.digest, agreeing, dissenting });
        while self.heights.len() > HEIGHTS_MAX {
            let Some((height, oldest)) = self.heights.pop_first() else { break };
            oldest.judge(height, self.agreeing_with(height))?;
        }
        Ok(())
    }

    /// Compares the attestations in an executed block.
    ///
    /// # Errors
    /// [`Code::ChainInvalid`] for a snapshot that a node attested otherwise.
    pub(super) fn block(&mut self, outcome: &Outcome) -> Result<(), Rejection> {
        let ours = |event: &&Event| event.chaincode == msp::NAME && event.name == "attested";
        for event in outcome.events.iter().map(|emitted| &emitted.event).filter(ours) {
            let said: Attestation = serde_json::from_slice(&event.payload).map_err(|error| {
                Rejection::new(Code::Internal, format!("the signed state of {} cannot be read: {error}", event.subject))
            })?;
            self.attestation(event.subject.clone(), &said.attest)?;
        }
        Ok(())
    }

    fn attestation(&mut self, node: String, record: &Attest) -> Result<(), Rejection> {
        let Attest { height, hash, digest, content } = record;
        if let (Some((begun, wanted)), Some(content)) = (self.snapshot, *content)
            && begun == *height
        {
            if content != wanted {
                let what = format!("{node} signed another snapshot at height {height} than the one before the blocks");
                return Err(Rejection::new(Code::ChainInvalid, what)
                    .found(format!("content {wanted}"))
                    .wanted(format!("content {content}")));
            }
            self.snapshot_attested_by.insert(node.clone());
        }
        let Some(computed) = self.heights.get_mut(height) else { return Ok(()) };
        if (computed.hash, computed.digest) == (*hash, *digest) {
            self.agreeing += u64::from(computed.agreeing.insert(node.clone()));
            let agreed = self.agreed.entry(node).or_default();
            *agreed = (*agreed).max(*height);
            return Ok(());
        }
        if computed.dissenting.insert(node.clone()) && self.dissents.len() < DISSENTS_MAX {
            self.dissents.push(Dissent { height: *height, node, hash: *hash, digest: *digest });
        }
        Ok(())
    }

    /// Judges what is left.
    ///
    /// # Errors
    /// [`Code::ChainInvalid`] with height and nodes if more nodes signed something else than these blocks give than
    /// signed this, or what follows from it.
    pub(super) fn finish(&self) -> Result<(), Rejection> {
        self.heights.iter().try_for_each(|(height, found)| found.judge(*height, self.agreeing_with(*height)))
    }

    /// How many nodes agree with the chain up to a height.
    fn agreeing_with(&self, height: u64) -> usize {
        self.agreed.values().filter(|agreed| **agreed >= height).count()
    }
}

impl Height {
    /// Are those wrong who attested something else, if so many agree?
    fn judge(&self, height: u64, agreeing: usize) -> Result<(), Rejection> {
        if self.dissenting.len() <= agreeing {
            return Ok(());
        }
        let names: Vec<&str> = self.dissenting.iter().map(String::as_str).collect();
        let what =
            format!("block {height}: {} signed another block or state than these blocks result in", names.join(", "));
        Err(Rejection::new(Code::ChainInvalid, what)
            .found(format!("block hash {}, state digest {}; {agreeing} nodes agree", self.hash, self.digest))
            .wanted("the state that most members signed at this height or a later one")
            .next("compare with the directory of one of these nodes"))
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn tip(height: u64) -> Tip {
        let [hash, digest] = ["hash", "digest"].map(|what| Hash::of(&[what.as_bytes(), &height.to_be_bytes()]));
        Tip { height, term: 1, time: height, hash, digest }
    }

    fn right(height: u64) -> Attest {
        Attest { height, hash: tip(height).hash, digest: tip(height).digest, content: None }
    }

    fn wrong(height: u64) -> Attest {
        Attest { digest: Hash::ZERO, ..right(height) }
    }

    fn chain(last: u64) -> Attested {
        let mut attested = Attested::default();
        (1..=last).for_each(|height| attested.computed(&tip(height)).unwrap());
        attested
    }

    #[test]
    fn a_node_that_attested_something_else_is_named_with_the_height() {
        let mut attested = chain(20);
        for node in ["Org1/a", "Org2/b", "Org2/b"] {
            attested.attestation(node.into(), &right(7)).unwrap();
        }
        attested.attestation("Org2/c".into(), &wrong(7)).unwrap();
        attested.attestation("Org2/c".into(), &wrong(99)).unwrap();
        attested.finish().unwrap();
        let named: Vec<_> = attested.dissents.iter().map(|dissent| (dissent.height, dissent.node.as_str())).collect();
        assert_eq!((attested.agreeing, named), (2, vec![(7, "Org2/c")]));
    }

    #[test]
    fn blocks_that_more_nodes_contradict_than_confirm_are_wrong() {
        let mut attested = chain(20);
        attested.attestation("Org1/a".into(), &wrong(3)).unwrap();
        let refused = attested.finish().unwrap_err();
        assert!(refused.code == Code::ChainInvalid && refused.message.contains("block 3: Org1/a"), "{refused}");
        attested.attestation("Org2/b".into(), &right(3)).unwrap();
        attested.finish().unwrap();
        attested.attestation("Org2/c".into(), &wrong(3)).unwrap();
        assert!(attested.finish().is_err());
    }

    #[test]
    fn who_agrees_with_a_block_agrees_with_those_before_it_and_not_with_those_after_it() {
        let mut attested = chain(20);
        attested.attestation("Org1/a".into(), &wrong(3)).unwrap();
        attested.attestation("Org2/b".into(), &right(2)).unwrap();
        assert!(attested.finish().unwrap_err().message.contains("block 3: Org1/a"));
        attested.attestation("Org2/b".into(), &right(4)).unwrap();
        attested.finish().unwrap();
        attested.attestation("Org1/a".into(), &wrong(5)).unwrap();
        assert!(attested.finish().unwrap_err().message.contains("block 5: Org1/a"));
    }

    #[test]
    fn memory_is_bounded_and_what_is_forgotten_was_judged() {
        let mut attested = chain(HEIGHTS_MAX as u64 + 5);
        assert_eq!(attested.heights.len(), HEIGHTS_MAX);
        attested.attestation("Org1/a".into(), &wrong(6)).unwrap();
        assert!(attested.computed(&tip(HEIGHTS_MAX as u64 + 6)).is_err());
    }

    #[test]
    fn a_snapshot_that_a_node_attested_otherwise_is_refused() {
        let mut attested = chain(20);
        attested.begin(10, tip(10).hash);
        attested.attestation("Org1/a".into(), &Attest { content: Some(tip(10).hash), ..right(10) }).unwrap();
        assert!(attested.snapshot_attested_by.contains("Org1/a"));
        let other = Attest { content: Some(Hash::ZERO), ..right(10) };
        assert!(attested.attestation("Org2/b".into(), &other).unwrap_err().message.contains("Org2/b"));
    }
}
