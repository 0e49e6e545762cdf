//! Statements of voters about other blocks than this node has, at any height.
//!
//! The [certifier](crate::certifier) counts statements about blocks that are due on this node's own chain. Another branch has
//! other block times, so other heights are due there. So the node keeps what each voter says about heights that it has not
//! executed, or at which it has another block. If enough voters have signed one of these, their strict certificate
//! contradicts the chain of this node.

use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;
use ledger_light::{Certificate, Signed};
use std::collections::BTreeMap;

/// Heights of which the statement of one voter is kept; the lowest make room.
const HEIGHTS_MAX: usize = 64;
/// Fewest signers that are worth a check of their signatures: no strict certificate has fewer.
const SIGNERS_MIN: usize = 2;

/// The statements of each voter about other blocks.
#[derive(Default)]
pub(super) struct Branches {
    /// By voter and height.
    said: BTreeMap<u64, BTreeMap<u64, Signed>>,
    /// How many signers a certificate had when it was answered last, by its height and block.
    answered: BTreeMap<(u64, Hash), usize>,
}

impl Branches {
    /// Keeps a statement of a voter. The caller knows that this voter has signed it, or that it has come from the voter itself.
    pub(super) fn heard(&mut self, signed: Signed) {
        let heights = self.said.entry(signed.signature.node).or_default();
        heights.insert(signed.statement.height, signed);
        while heights.len() > HEIGHTS_MAX {
            heights.pop_first();
        }
    }

    /// Forgets what agrees with the own chain, and answers with the statements of several voters that do not, each as a
    /// certificate whose signatures are not checked. `own` is the block at a height; none if it was not executed yet, or is not
    /// known any more. A certificate is answered again when it has more signatures.
    ///
    /// # Errors
    /// As `own`.
    pub(super) fn contradicting(
        &mut self,
        tip: u64,
        mut own: impl FnMut(u64) -> Result<Option<Hash>, Rejection>,
    ) -> Result<Vec<Certificate>, Rejection> {
        let mut blocks: BTreeMap<u64, Option<Hash>> = BTreeMap::new();
        for height in self.said.values().flat_map(BTreeMap::keys).filter(|height| **height <= tip) {
            if !blocks.contains_key(height) {
                blocks.insert(*height, own(*height)?);
            }
        }
        let mut found: BTreeMap<(u64, Hash, Hash, u64), Vec<&Signed>> = BTreeMap::new();
        for heights in self.said.values_mut() {
            heights.retain(|height, signed| match blocks.get(height) {
                None => true,
                Some(own) => own.is_some_and(|own| own != signed.statement.block),
            });
            for (height, signed) in heights.range(..=tip) {
                let statement = &signed.statement;
                found.entry((*height, statement.block, statement.results, statement.time)).or_default().push(signed);
            }
        }
        let mut certificates = Vec::new();
        for ((height, block, ..), signed) in found.into_iter().filter(|(_, signed)| signed.len() >= SIGNERS_MIN) {
            let before = self.answered.insert((height, block), signed.len()).unwrap_or_default();
            let Some(first) = signed.first().filter(|_| signed.len() > before) else { continue };
            // Voters ascend.
            let signatures = signed.iter().map(|signed| signed.signature.clone()).collect();
            certificates.push(Certificate { statement: first.statement, signatures });
        }
        let said = &self.said;
        self.answered.retain(|(height, _), _| said.values().any(|heights| heights.contains_key(height)));
        Ok(certificates)
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use bytes::Bytes;
    use ledger_light::{Signature, Statement};

    fn signed(node: u64, height: u64, block: u8) -> Signed {
        let block = Hash([block; 32]);
        let statement = Statement { network: Hash::ZERO, recoveries: 0, height, time: 1, block, results: Hash::ZERO };
        Signed { statement, signature: Signature { node, certificate: Bytes::new(), signature: Bytes::new() } }
    }

    /// A chain whose blocks have the hash 1, of which those before 3 are not known any more.
    fn own(height: u64) -> Result<Option<Hash>, Rejection> {
        Ok((height >= 3).then_some(Hash([1; 32])))
    }

    fn signers(branches: &mut Branches, tip: u64) -> Vec<(u64, Vec<u64>)> {
        let found = branches.contradicting(tip, own).unwrap();
        let nodes = |certificate: &Certificate| certificate.signatures.iter().map(|one| one.node).collect();
        found.iter().map(|found| (found.statement.height, nodes(found))).collect()
    }

    #[test]
    fn voters_that_say_the_same_other_block_are_put_together_once_for_each_signer_more() {
        let mut branches = Branches::default();
        for (node, height, block) in [(2, 5, 9), (3, 5, 8), (4, 5, 1), (4, 4, 1), (1, 2, 9), (2, 2, 9)] {
            branches.heard(signed(node, height, block));
        }
        assert_eq!(signers(&mut branches, 9), [], "two voters, two other blocks");
        branches.heard(signed(4, 5, 9));
        assert_eq!(signers(&mut branches, 9), [(5, vec![2, 4])]);
        assert_eq!(signers(&mut branches, 9), []);
        branches.heard(signed(1, 5, 9));
        assert_eq!(signers(&mut branches, 9), [(5, vec![1, 2, 4])]);
    }

    #[test]
    fn statements_about_blocks_to_come_wait_until_this_node_has_a_block_there() {
        let mut branches = Branches::default();
        for node in 1..4 {
            branches.heard(signed(node, 7, 9));
        }
        assert_eq!(signers(&mut branches, 6), []);
        assert_eq!(signers(&mut branches, 7), [(7, vec![1, 2, 3])]);
        for height in 100..200 {
            branches.heard(signed(1, height, 9));
        }
        assert_eq!(branches.said.values().map(BTreeMap::len).max(), Some(HEIGHTS_MAX));
    }
}
