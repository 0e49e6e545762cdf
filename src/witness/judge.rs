//! Compares what other nodes attest with what this node has computed.
//!
//! An attestation names a height, the hash of its block and the state digest after it. The digest covers everything
//! since the genesis, so once two nodes differ they differ for ever, and where that began is found by halving.

use std::collections::BTreeMap;

/// The meaning of an attestation for this node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Finding {
    /// It says what this node has computed.
    Agrees,
    /// It says something else; nobody knows yet who is right.
    Differs,
    /// More than half of the members say something else: this node is the one that is wrong.
    Outvoted,
}

/// The members that differ from this node, by the newest attestation of each.
#[derive(Debug, Default)]
pub(crate) struct Judge {
    /// Attesting node, `ORGANISATION/NAME`, and the height at which it differed first.
    differing: BTreeMap<String, u64>,
}

impl Judge {
    /// Judges an attestation: `agrees` is whether it says what this node has for `height`, `members` how many nodes the
    /// network has, this one included.
    pub(crate) fn judge(&mut self, by: &str, height: u64, agrees: bool, members: usize) -> Finding {
        if agrees {
            self.differing.remove(by);
            return Finding::Agrees;
        }
        self.differing.entry(by.to_owned()).or_insert(height);
        if self.differing.len() * 2 > members { Finding::Outvoted } else { Finding::Differs }
    }

    /// The members that differ, in words; empty if nobody does.
    pub(crate) fn describe(&self) -> String {
        let differing: Vec<_> =
            self.differing.iter().map(|(node, height)| format!("{node} differs at height {height}")).collect();
        differing.join(", ")
    }

    /// A node that differs and the height at which that was noticed.
    pub(crate) fn first(&self) -> Option<(&str, u64)> {
        self.differing.iter().map(|(node, height)| (node.as_str(), *height)).next()
    }
}

/// The next height to compare when the digests agree at `agreed` and differ at `differing`; none when that is the first
/// difference.
pub(crate) fn halve(agreed: u64, differing: u64) -> Option<u64> {
    (differing > agreed + 1).then(|| agreed + (differing - agreed) / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_that_more_than_half_contradict_is_outvoted() {
        let mut judge = Judge::default();
        assert_eq!(judge.judge("Org1/node1", 10, true, 4), Finding::Agrees);
        assert_eq!(judge.judge("Org1/node1", 20, false, 4), Finding::Differs);
        assert_eq!(judge.judge("Org2/node2", 20, false, 4), Finding::Differs, "two of four are not more than half");
        assert_eq!(judge.judge("Org2/node3", 20, false, 4), Finding::Outvoted);
    }

    #[test]
    fn one_node_that_contradicts_again_and_again_counts_once() {
        let mut judge = Judge::default();
        for height in [10, 20, 30] {
            assert_eq!(judge.judge("Org1/node1", height, false, 3), Finding::Differs);
        }
        assert_eq!(judge.describe(), "Org1/node1 differs at height 10");
    }

    #[test]
    fn a_node_that_was_repaired_no_longer_counts() {
        let mut judge = Judge::default();
        judge.judge("Org1/node1", 10, false, 3);
        judge.judge("Org1/node1", 20, true, 3);
        assert_eq!(judge.judge("Org2/node2", 20, false, 3), Finding::Differs);
    }

    #[test]
    fn halving_finds_the_first_difference() {
        let first = 777;
        let (mut agreed, mut differing, mut questions) = (0, 10_000, 0);
        while let Some(height) = halve(agreed, differing) {
            questions += 1;
            if height >= first { differing = height } else { agreed = height }
        }
        assert_eq!(differing, first);
        assert!(questions <= 14, "{questions}");
    }
}
