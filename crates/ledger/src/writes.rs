//! The writes of recent blocks, to find the key with which two nodes that differ began to differ.

use bytes::Bytes;
use ledger_base::hash::Hash;
use ledger_storage::state::WriteSet;
use std::collections::VecDeque;

/// Most blocks whose writes are kept.
pub const WRITES_BLOCKS_MAX: usize = 4096;
/// Most bytes of keys and values that are kept.
pub const WRITES_BYTES_MAX: usize = 4 * 1024 * 1024;

/// One write of a block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Write {
    /// The full key.
    pub key: Bytes,
    /// SHA-256 of the value; none if the key was deleted.
    pub value: Option<Hash>,
}

/// The writes of the last blocks. Copied, so that they keep nothing larger alive.
#[derive(Default)]
pub(crate) struct RecentWrites {
    blocks: VecDeque<Block>,
    bytes: usize,
}

struct Block {
    height: u64,
    /// Keys and values one after the other.
    bytes: Vec<u8>,
    /// Length of each key, and of its value if it has one.
    lengths: Vec<(u32, Option<u32>)>,
}

impl RecentWrites {
    /// Keeps the writes of the next block.
    pub(crate) fn push(&mut self, height: u64, writes: &WriteSet) {
        let total = writes.iter().map(|(key, value)| key.len() + value.as_ref().map_or(0, Bytes::len)).sum();
        let mut block = Block { height, bytes: Vec::new(), lengths: Vec::with_capacity(writes.len()) };
        if total <= WRITES_BYTES_MAX {
            block.bytes.reserve_exact(total);
            for (key, value) in writes {
                block.bytes.extend_from_slice(key);
                block.bytes.extend_from_slice(value.as_deref().unwrap_or_default());
                block.lengths.push((length(key), value.as_ref().map(length)));
            }
            self.bytes += block.weight();
            self.blocks.push_back(block);
        } else {
            // A gap would be taken for a block that wrote nothing.
            *self = Self::default();
        }
        while self.blocks.len() > WRITES_BLOCKS_MAX || self.bytes > WRITES_BYTES_MAX {
            let Some(oldest) = self.blocks.pop_front() else { break };
            self.bytes -= oldest.weight();
        }
    }

    /// The writes of the block at a height, in order of keys; none if they are not kept.
    pub(crate) fn get(&self, height: u64) -> Option<Vec<Write>> {
        let number = height.checked_sub(self.blocks.front()?.height)?;
        let block = self.blocks.get(usize::try_from(number).ok()?)?;
        let mut rest = block.bytes.as_slice();
        let writes = block.lengths.iter().map(|(key, value)| {
            let (key, after) = rest.split_at_checked(*key as usize)?;
            let (content, after) = after.split_at_checked(value.unwrap_or(0) as usize)?;
            rest = after;
            Some(Write { key: Bytes::copy_from_slice(key), value: value.map(|_| Hash::of(&[content])) })
        });
        writes.collect()
    }
}

impl Block {
    fn weight(&self) -> usize {
        self.bytes.len() + self.lengths.len() * 12 + 64
    }
}

fn length(bytes: &Bytes) -> u32 {
    u32::try_from(bytes.len()).unwrap_or(u32::MAX)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn writes(bytes: usize) -> WriteSet {
        let value = Bytes::from(vec![7; bytes]);
        WriteSet::from([(Bytes::from("a\0gone"), None), (Bytes::from("a\0here"), Some(value))])
    }

    #[test]
    fn the_writes_of_recent_blocks_are_told_with_hashes_of_their_values() {
        let mut recent = RecentWrites::default();
        recent.push(5, &writes(3));
        recent.push(6, &WriteSet::new());
        let told = recent.get(5).unwrap();
        assert_eq!(told.first().unwrap(), &Write { key: Bytes::from("a\0gone"), value: None });
        assert_eq!(told.get(1).unwrap().value, Some(Hash::of(&[&[7, 7, 7]])));
        assert_eq!(recent.get(6), Some(Vec::new()));
        assert!(recent.get(4).is_none() && recent.get(7).is_none());
    }

    #[test]
    fn memory_is_bounded_by_blocks_and_by_bytes() {
        let mut recent = RecentWrites::default();
        (1..=WRITES_BLOCKS_MAX as u64 + 10).for_each(|height| recent.push(height, &WriteSet::new()));
        assert!(recent.get(10).is_none() && recent.get(11).is_some());
        (1..=20).for_each(|height| recent.push(WRITES_BLOCKS_MAX as u64 + 10 + height, &writes(1024 * 1024)));
        assert!(recent.bytes <= WRITES_BYTES_MAX && recent.blocks.len() == 3);
        recent.push(WRITES_BLOCKS_MAX as u64 + 31, &writes(WRITES_BYTES_MAX));
        assert!(recent.blocks.is_empty());
    }
}
