//! The attestations of a node, and their time: the newest block that holds anything but attestations, and each of its snapshots.

use ledger::msp::{self, Attest, Attestation};
use ledger::{Ledger, Outcome};
use ledger_base::rejection::Rejection;
use ledger_storage::snapshot::Snapshots;
use ledger_storage::state::Tip;

/// The name of the event that an attestation causes; its subject is the node, `ORGANISATION/NAME`.
const EVENT: &str = "attested";

/// An attestation that was executed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Its signer, `ORGANISATION/NAME`.
    pub by: String,
    /// The statement.
    pub attest: Attest,
}

/// The attestations of a block, and whether it holds anything else.
pub fn seen(outcome: &Outcome) -> (Vec<Seen>, bool) {
    let events = outcome.events.iter().map(|emitted| &emitted.event);
    let attested = events.filter(|event| event.chaincode == msp::NAME && event.name == EVENT);
    let count = attested.clone().count();
    let read = attested.filter_map(|event| {
        let Attestation { attest, .. } = serde_json::from_slice(&event.payload).ok()?;
        Some(Seen { by: event.subject.clone(), attest })
    });
    (read.collect(), outcome.results.len() > count)
}

/// The heights that a node has attested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Said {
    /// The greatest height.
    pub height: u64,
    /// The greatest height of a snapshot.
    pub snapshot: u64,
}

impl Said {
    /// Takes note of an attestation of the node itself.
    pub fn note(&mut self, attest: &Attest) {
        self.height = self.height.max(attest.height);
        self.snapshot = self.snapshot.max(attest.content.map_or(0, |_| attest.height));
    }

    /// The snapshot that the node attests now, if it is new.
    ///
    /// # Errors
    /// A fault of the store.
    pub fn snapshot_due(&self, ledger: &Ledger, snapshots: &Snapshots) -> Result<Option<Attest>, Rejection> {
        let Some(snapshot) = snapshots.newest() else { return Ok(None) };
        let (height, content) = (snapshot.manifest().height, snapshot.content());
        let block = ledger.block_hashes(height)?.filter(|_| height > self.snapshot);
        Ok(block.map(|block| Attest { height, hash: block.hash, digest: block.digest, content: Some(content) }))
    }

    /// The block that the node attests now. `ordinary`: the newest that holds anything but attestations. A network in
    /// which nothing happens attests nothing. `durable`: what the log holds on the disk. A learner executes what is
    /// committed before that: after a power cut it would have attested a block that it does not hold.
    pub fn block_due(&self, tip: &Tip, ordinary: u64, durable: u64) -> Option<Attest> {
        (ordinary > self.height && tip.height <= durable).then_some(Attest {
            height: tip.height,
            hash: tip.hash,
            digest: tip.digest,
            content: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ledger_base::hash::Hash;

    #[test]
    fn a_node_attests_its_newest_block_if_anything_happened_and_its_own_disk_holds_it() {
        let tip = Tip { height: 7, term: 1, time: 1, hash: Hash([1; 32]), digest: Hash([2; 32]) };
        let said = Said { height: 5, snapshot: 0 };
        let due =
            |ordinary, durable| said.block_due(&tip, ordinary, durable).map(|attest| (attest.height, attest.hash));
        assert_eq!(due(6, 7), Some((7, Hash([1; 32]))));
        assert_eq!(due(6, 9), Some((7, Hash([1; 32]))));
        assert_eq!(due(5, 7), None, "nothing but attestations came since");
        assert_eq!(due(6, 6), None, "a learner has executed what its disk does not hold");
    }
}
