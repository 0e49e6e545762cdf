//! The Merkle tree of RFC 6962 §2.1, over leaves that are hashes already.

use crate::codec::Reader;
use ledger_base::hash::Hash;
use ledger_base::rejection::Rejection;

/// Most hashes in a path: a tree of 2^32 leaves has no longer one.
pub const SIBLINGS_MAX: usize = 32;
/// Longest encoding of a path.
pub const PATH_BYTES_MAX: usize = 4 + 4 + 1 + SIBLINGS_MAX * 32;

/// The hash of two subtrees.
fn node(left: &Hash, right: &Hash) -> Hash {
    Hash::of(&[&[0x01], &left.0, &right.0])
}

/// The hashes one level above these; an odd one is promoted.
fn above(level: &[Hash]) -> Vec<Hash> {
    let pair = |pair: &[Hash]| match pair {
        [left, right] => node(left, right),
        [single] => *single,
        _ => Hash::ZERO,
    };
    level.chunks(2).map(pair).collect()
}

/// The root over leaves: the hash of nothing for none; an odd node is promoted.
pub fn root(mut level: Vec<Hash>) -> Hash {
    if level.is_empty() {
        return Hash::of(&[]);
    }
    while level.len() > 1 {
        level = above(&level);
    }
    level.first().copied().unwrap_or(Hash::ZERO)
}

/// The way from a leaf to its root.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Path {
    /// Position of the leaf, from 0.
    pub index: u32,
    /// Number of leaves of the tree.
    pub count: u32,
    /// The hashes beside the way, from the leaf upwards.
    pub siblings: Vec<Hash>,
}

impl Path {
    /// The path of the leaf at a position; none if there is no such leaf.
    pub fn new(leaves: &[Hash], index: u32) -> Option<Self> {
        let (mut at, count) = (index as usize, u32::try_from(leaves.len()).ok()?);
        leaves.get(at)?;
        let (mut level, mut siblings) = (leaves.to_vec(), Vec::new());
        while level.len() > 1 {
            siblings.extend(level.get(at ^ 1));
            (level, at) = (above(&level), at / 2);
        }
        Some(Self { index, count, siblings })
    }

    /// Does this path lead from that leaf to that root?
    pub fn leads(&self, leaf: Hash, root: Hash) -> bool {
        self.root(leaf) == Some(root)
    }

    /// The root to which this path leads from that leaf; none if it is no path of a tree.
    pub fn root(&self, leaf: Hash) -> Option<Hash> {
        if self.index >= self.count {
            return None;
        }
        // Position of the way's node and of the last node, level by level.
        let (mut at, mut last, mut reached) = (self.index, self.count - 1, leaf);
        let mut siblings = self.siblings.iter();
        while last > 0 {
            let alone = at == last && at.is_multiple_of(2);
            if !alone {
                let sibling = siblings.next()?;
                reached = if at.is_multiple_of(2) { node(&reached, sibling) } else { node(sibling, &reached) };
            }
            (at, last) = (at / 2, last / 2);
        }
        siblings.next().is_none().then_some(reached)
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = [self.index.to_be_bytes(), self.count.to_be_bytes()].concat();
        bytes.push(self.siblings.len() as u8);
        self.siblings.iter().for_each(|sibling| bytes.extend_from_slice(&sibling.0));
        bytes
    }

    /// Reads its bytes.
    ///
    /// # Errors
    /// [`Code::TooLarge`](ledger_base::rejection::Code::TooLarge), [`Code::Malformed`](ledger_base::rejection::Code::Malformed).
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let mut reader = Reader::new("a Merkle path", PATH_BYTES_MAX, b"", bytes)?;
        let (index, count, length) = (reader.u32()?, reader.u32()?, usize::from(reader.byte()?));
        if index >= count || length > SIBLINGS_MAX {
            return Err(reader.malformed("a leaf beyond the tree, or too many hashes", "a path of a tree"));
        }
        let siblings = (0..length).map(|_| reader.hash()).collect::<Result<_, _>>()?;
        reader.end()?;
        Ok(Self { index, count, siblings })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    fn leaves(count: u32) -> Vec<Hash> {
        (0..count).map(|number| Hash::of(&[&number.to_be_bytes()])).collect()
    }

    #[test]
    fn each_leaf_has_a_path_to_the_root_that_no_other_leaf_place_or_tree_fits() {
        for count in 1..=33u32 {
            let (leaves, smaller) = (leaves(count), leaves(count - 1));
            let top = root(leaves.clone());
            for index in 0..count {
                let path = Path::new(&leaves, index).unwrap();
                assert!(path.leads(leaves[index as usize], top), "{index} of {count}");
                assert_eq!(Path::from_bytes(&path.to_bytes()).unwrap(), path);
                assert!(!path.leads(Hash::ZERO, top) && !path.leads(leaves[index as usize], root(smaller.clone())));
                for other in (0..count).filter(|other| *other != index) {
                    let moved = Path { index: other, ..path.clone() };
                    assert!(!moved.leads(leaves[index as usize], top), "{index} as {other} of {count}");
                }
                for cut in 0..path.siblings.len() {
                    let cut = Path { siblings: path.siblings[..cut].to_vec(), ..path.clone() };
                    assert!(!cut.leads(leaves[index as usize], top), "a shorter path");
                }
                let longer = Path { siblings: [&path.siblings[..], &[Hash::ZERO]].concat(), ..path };
                assert!(!longer.leads(leaves[index as usize], top), "a longer path");
            }
            assert_eq!(Path::new(&leaves, count), None);
        }
    }

    #[test]
    fn the_root_depends_on_every_leaf_and_on_their_order() {
        let five = leaves(5);
        let mut swapped = five.clone();
        swapped.swap(0, 4);
        assert_ne!(root(swapped), root(five.clone()));
        for index in 0..five.len() {
            let mut changed = five.clone();
            changed[index] = Hash::ZERO;
            assert_ne!(root(changed), root(five.clone()), "leaf {index}");
        }
        assert_eq!((root(five[..1].to_vec()), root(Vec::new())), (five[0], Hash::of(&[])));
    }
}
