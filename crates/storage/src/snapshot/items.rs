//! The stream of items that the chunks are cut from.

use super::Snapshot;
use crate::result::BlockResult;
use bytes::{Buf, Bytes, BytesMut};
use ledger_base::rejection::{Code, Rejection};

const PAIR: u8 = 1;
const RESULT: u8 = 2;

/// Most bytes of a key with the name of its chaincode.
const KEY_BYTES_MAX: usize = 2 * 1024;
/// Most bytes of a value.
const VALUE_BYTES_MAX: usize = 4 * 1024 * 1024;
/// Most bytes of a result: responses to 4096 transactions.
const RESULT_BYTES_MAX: usize = 1024 * 1024 * 1024;

/// The parts of a snapshot.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// A key of the world state and its value.
    Pair(Bytes, Bytes),
    /// The result of a block of the last 120 s, and its height.
    Result(u64, BlockResult),
}

/// Appends a pair to the stream.
pub(super) fn put_pair(key: &[u8], value: &[u8], out: &mut Vec<u8>) {
    out.push(PAIR);
    out.extend(length(key));
    out.extend(length(value));
    out.extend(key);
    out.extend(value);
}

/// Appends a result to the stream.
pub(super) fn put_result(height: u64, result: &[u8], out: &mut Vec<u8>) {
    out.push(RESULT);
    out.extend(height.to_be_bytes());
    out.extend(length(result));
    out.extend(result);
}

fn length(bytes: &[u8]) -> [u8; 4] {
    u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_be_bytes()
}

/// Reads the items of a snapshot in order, chunk by chunk, each of them verified. Ends after the first error.
pub struct Items<'a> {
    snapshot: &'a Snapshot,
    /// Number of the chunk that is read next.
    chunk: usize,
    /// Bytes of chunks that are not items yet.
    rest: BytesMut,
    /// Key of the pair before.
    key: Bytes,
    /// Height of the result before.
    height: Option<u64>,
    /// End before the results.
    pairs_only: bool,
    failed: bool,
}

impl<'a> Items<'a> {
    pub(super) fn new(snapshot: &'a Snapshot, pairs_only: bool) -> Self {
        Self { snapshot, chunk: 0, rest: BytesMut::new(), key: Bytes::new(), height: None, pairs_only, failed: false }
    }

    fn read(&mut self) -> Result<Option<Item>, Rejection> {
        if !self.fill(1)? {
            let reached = self.snapshot.manifest().height;
            return match self.height {
                None if self.pairs_only => Ok(None),
                Some(height) if height == reached => Ok(None),
                _ => Err(self.wrong("it ends before the result of its last block")),
            };
        }
        match self.rest.get_u8() {
            PAIR if self.height.is_none() => self.pair().map(Some),
            // Whoever only looks for pairs does not trust this snapshot yet, and results may be large.
            RESULT if self.pairs_only => Ok(None),
            RESULT => self.result().map(Some),
            _ => Err(self.wrong("an item of unknown kind, or out of order")),
        }
    }

    fn pair(&mut self) -> Result<Item, Rejection> {
        self.need(8)?;
        let (key, value) = (self.rest.get_u32() as usize, self.rest.get_u32() as usize);
        if key > KEY_BYTES_MAX || value > VALUE_BYTES_MAX {
            return Err(self.wrong("a pair is too large"));
        }
        self.need(key + value)?;
        // Copied: what is taken from the buffer would keep a whole chunk in memory.
        let (key, value) = (self.rest.copy_to_bytes(key), self.rest.copy_to_bytes(value));
        let (key, value) = (Bytes::copy_from_slice(&key), Bytes::copy_from_slice(&value));
        if key.first().is_none_or(|first| *first == 0) || key <= self.key {
            return Err(self.wrong("keys are not in order, or belong to no chaincode"));
        }
        self.key = key.clone();
        Ok(Item::Pair(key, value))
    }

    fn result(&mut self) -> Result<Item, Rejection> {
        self.need(12)?;
        let (height, length) = (self.rest.get_u64(), self.rest.get_u32() as usize);
        let follows = self.height.is_none_or(|before| before + 1 == height);
        if length > RESULT_BYTES_MAX || !follows || height == 0 || height > self.snapshot.manifest().height {
            return Err(self.wrong("results of blocks are too large or not in order"));
        }
        self.need(length)?;
        self.height = Some(height);
        let result = BlockResult::from_bytes(self.rest.copy_to_bytes(length));
        Ok(Item::Result(height, result.map_err(|_| self.wrong("a result cannot be read"))?))
    }

    fn need(&mut self, bytes: usize) -> Result<(), Rejection> {
        if self.fill(bytes)? { Ok(()) } else { Err(self.wrong("it ends inside an item")) }
    }

    /// Reads on until so many bytes are there; false if they never will be.
    fn fill(&mut self, bytes: usize) -> Result<bool, Rejection> {
        while self.rest.len() < bytes {
            if self.chunk >= self.snapshot.manifest().chunks.len() {
                return Ok(false);
            }
            self.rest.extend_from_slice(&self.snapshot.chunk(self.chunk)?);
            self.chunk += 1;
        }
        Ok(true)
    }

    fn wrong(&self, what: &str) -> Rejection {
        let height = self.snapshot.manifest().height;
        Rejection::new(
            Code::Corrupt,
            format!("the bytes of the snapshot of height {height} are not a snapshot: {what}"),
        )
        .next("use another snapshot, from another node")
    }
}

impl Iterator for Items<'_> {
    type Item = Result<Item, Rejection>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let item = self.read().transpose();
        self.failed = item.as_ref().is_none_or(Result::is_err);
        item
    }
}
