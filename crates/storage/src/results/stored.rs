//! The result of a block as it is kept: without what the block beside it tells.

use crate::result::{BlockKind, BlockResult, EmittedEvent, Roots, TransactionResult};
use bytes::{Buf, Bytes};
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use prost::Message;

/// Bytes of an id that are kept where the block has the rest: enough to tell duplicates, so that a node starts without
/// reading its blocks.
pub const SHORT_ID_BYTES: usize = 16;
/// Bytes of a transaction that came out as foretold.
const CALL_BYTES: usize = 1 + SHORT_ID_BYTES + 4;

/// Marks a transaction that came out as foretold. Its id and until when it is remembered (`u32` LE) follow.
const FORETOLD: u8 = 1;
/// Marks one whose result is among the results.
const OTHERWISE: u8 = 0;

/// A result that is kept whole, or short: beside its block.
///
/// Short, it has no term; ids are cut to [`SHORT_ID_BYTES`]; `not_after` counts from the block's time. A transaction
/// that came out as its call foretells has neither response nor events.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredResult {
    result: BlockResult,
    /// Short: which transactions came out as foretold. Whole: empty.
    foretold: Vec<bool>,
}

/// The bytes of a short result. A whole one is a [`BlockResult`]; it has no `calls`, and nothing else that is short has
/// none.
#[derive(Clone, PartialEq, prost::Message)]
struct Short {
    #[prost(uint64, tag = "2")]
    time: u64,
    /// Of transactions that did not come out as foretold.
    #[prost(message, repeated, tag = "6")]
    results: Vec<TransactionResult>,
    #[prost(message, repeated, tag = "7")]
    events: Vec<EmittedEvent>,
    /// For each transaction [`FORETOLD`] and what follows it, or [`OTHERWISE`].
    #[prost(bytes = "bytes", tag = "8")]
    calls: Bytes,
    /// Hash and digest of the block, the hash over its writes, then its [`Roots`] if it has them.
    #[prost(bytes = "bytes", tag = "9")]
    link: Bytes,
}

impl StoredResult {
    /// All of it: for results that came without their blocks.
    pub(super) fn whole(result: BlockResult) -> Self {
        Self { result, foretold: Vec::new() }
    }

    /// The part that its block does not tell. `foretold` says which transactions came out as their calls foretell.
    pub(super) fn short(result: &BlockResult, foretold: &[bool]) -> Self {
        // What was executed is remembered for 120 s at most, which fits; anything else is kept as it is.
        let fits = |outcome: &TransactionResult| {
            let left = outcome.not_after.and_then(|not_after| not_after.checked_sub(result.time));
            outcome.id.len() >= SHORT_ID_BYTES && left.is_some_and(|left| u32::try_from(left).is_ok())
        };
        let outcomes = result.results.iter().zip(foretold);
        let foretold: Vec<bool> = outcomes.map(|(outcome, foretold)| *foretold && fits(outcome)).collect();
        let told = |index: Option<u32>| index.and_then(|index| foretold.get(index as usize)).is_some_and(|told| *told);
        let results = result.results.iter().zip(&foretold).map(|(outcome, foretold)| TransactionResult {
            response: if *foretold { Bytes::new() } else { outcome.response.clone() },
            id: outcome.id.slice(..outcome.id.len().min(SHORT_ID_BYTES)),
            not_after: outcome.not_after.map(|not_after| not_after.saturating_sub(result.time)),
            ..outcome.clone()
        });
        let short = BlockResult {
            term: 0,
            time: result.time,
            hash: result.hash.clone(),
            digest: result.digest.clone(),
            kind: result.kind,
            results: results.collect(),
            events: result.events.iter().filter(|emitted| !told(emitted.index)).cloned().collect(),
            roots: result.roots.clone(),
            writes: result.writes.clone(),
        };
        Self { result: short, foretold }
    }

    pub(super) fn to_bytes(&self) -> Bytes {
        if !self.is_short() {
            return self.result.to_bytes();
        }
        let (mut calls, mut results) = (Vec::with_capacity(self.foretold.len() * CALL_BYTES), Vec::new());
        for (outcome, foretold) in self.result.results.iter().zip(&self.foretold) {
            if *foretold {
                calls.push(FORETOLD);
                calls.extend(&outcome.id);
                calls.extend((outcome.not_after.unwrap_or_default() as u32).to_le_bytes());
            } else {
                calls.push(OTHERWISE);
                results.push(outcome.clone());
            }
        }
        let BlockResult { time, hash, digest, writes, events, roots, .. } = &self.result;
        let link = [hash.as_ref(), digest, writes, roots].concat().into();
        Short { time: *time, results, events: events.clone(), calls: calls.into(), link }.encode_to_vec().into()
    }

    pub(super) fn from_bytes(bytes: Bytes) -> Result<Self, Rejection> {
        let unreadable =
            |what: &str| Rejection::new(Code::Corrupt, format!("a stored block result cannot be read: {what}"));
        let short = Short::decode(bytes.clone()).map_err(|error| unreadable(&error.to_string()))?;
        if short.calls.is_empty() {
            return BlockResult::from_bytes(bytes).map(Self::whole);
        }
        let Short { time, results, events, mut calls, mut link } = short;
        let mut others = results.into_iter();
        let (mut results, mut foretold) = (Vec::new(), Vec::new());
        while !calls.is_empty() {
            let mark = calls.get_u8();
            let outcome = match mark {
                FORETOLD => foretold_outcome(&mut calls),
                OTHERWISE => others.next(),
                _ => None,
            };
            results.push(outcome.ok_or_else(|| unreadable("transactions without a result"))?);
            foretold.push(mark == FORETOLD);
        }
        if others.next().is_some() || ![3 * size_of::<Hash>(), 6 * size_of::<Hash>()].contains(&link.len()) {
            return Err(unreadable("results without a transaction, or no hashes"));
        }
        let mut hash = || link.split_to(size_of::<Hash>());
        let (hash, digest, writes) = (hash(), hash(), hash());
        let kind = BlockKind::Transactions.into();
        let result = BlockResult { term: 0, time, hash, digest, kind, results, events, roots: link, writes };
        Ok(Self { result, foretold })
    }

    /// Block time, microseconds.
    pub fn time(&self) -> u64 {
        self.result.time
    }

    /// Hash of the block's header.
    pub fn hash(&self) -> Hash {
        self.result.hash()
    }

    /// State digest after the block.
    pub fn digest(&self) -> Hash {
        self.result.digest()
    }

    /// Governing chain, control chain and results root.
    pub fn roots(&self) -> Option<Roots> {
        self.result.roots()
    }

    /// Does it take the block to read it?
    pub fn is_short(&self) -> bool {
        !self.foretold.is_empty()
    }

    /// The transactions whose ids the block has taken: position, the first half of the id, until when it is remembered.
    pub fn taken(&self) -> impl Iterator<Item = (u32, Hash, u64)> + '_ {
        let since = if self.is_short() { self.result.time } else { 0 };
        (0u32..).zip(&self.result.results).filter_map(move |(position, result)| {
            Some((position, half(&result.id), result.not_after?.saturating_add(since)))
        })
    }

    /// The kept part, and the transactions that came out as foretold. The second is empty if the first is the whole
    /// result.
    pub fn into_parts(self) -> (BlockResult, Vec<bool>) {
        (self.result, self.foretold)
    }

    /// Is the transaction at this position the one with this id? Compares what is kept of it.
    pub(super) fn has(&self, position: u32, id: &Hash) -> bool {
        let found = self.result.results.get(position as usize);
        found.is_some_and(|result| result.id.len() >= SHORT_ID_BYTES && id.0.starts_with(&result.id))
    }
}

/// The kept part of a transaction that came out as foretold.
fn foretold_outcome(calls: &mut Bytes) -> Option<TransactionResult> {
    if calls.len() < CALL_BYTES - 1 {
        return None;
    }
    let id = calls.split_to(SHORT_ID_BYTES);
    Some(TransactionResult { id, not_after: Some(calls.get_u32_le().into()), ..TransactionResult::default() })
}

/// The first half of an id, then zeros.
fn half(id: &[u8]) -> Hash {
    let mut half = Hash::ZERO;
    half.0.iter_mut().zip(id.iter().take(SHORT_ID_BYTES)).for_each(|(to, from)| *to = *from);
    half
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::result::Event;

    fn stored(roots: &'static [u8]) -> StoredResult {
        let outcome = |n: u8| TransactionResult {
            response: Bytes::from(vec![n; 40]),
            id: Bytes::from(vec![n; 32]),
            not_after: Some(1_000_000 + u64::from(n)),
            ..TransactionResult::default()
        };
        let event = Event { chaincode: "a".into(), name: "b".into(), subject: "c".into(), payload: "d".into() };
        let result = BlockResult {
            term: 7,
            time: 1_000_000,
            hash: Bytes::from(vec![1; 32]),
            digest: Bytes::from(vec![2; 32]),
            kind: BlockKind::Transactions.into(),
            results: (1..=3).map(outcome).collect(),
            events: (0..3).map(|index| EmittedEvent { index: Some(index), event: event.clone() }).collect(),
            roots: Bytes::from_static(roots),
            writes: Bytes::from(vec![3; 32]),
        };
        StoredResult::short(&result, &[true, false, true])
    }

    #[test]
    fn a_short_result_reads_as_it_was_written() {
        let stored = stored(&[]);
        assert_eq!(StoredResult::from_bytes(stored.to_bytes()).unwrap(), stored);
        assert_eq!(stored.roots(), None);
        let rooted = self::stored(&[5; 96]);
        assert_eq!(StoredResult::from_bytes(rooted.to_bytes()).unwrap(), rooted);
        assert_eq!(
            rooted.roots(),
            Some(Roots { governing: Hash([5; 32]), control: Hash([5; 32]), results: Hash([5; 32]) })
        );
        assert_eq!(stored.result.events.len(), 1);
        let taken: Vec<_> = stored.taken().map(|(position, _, not_after)| (position, not_after)).collect();
        assert_eq!(taken, [(0, 1_000_001), (1, 1_000_002), (2, 1_000_003)]);
        assert!(stored.has(2, &Hash([3; 32])) && !stored.has(2, &Hash([1; 32])) && !stored.has(3, &Hash([3; 32])));
    }

    #[test]
    fn a_short_result_that_was_cut_or_changed_is_refused_or_another_one() {
        let (stored, bytes) = (stored(&[5; 96]), stored(&[5; 96]).to_bytes());
        for cut in 0..bytes.len() {
            let read = StoredResult::from_bytes(bytes.slice(..cut));
            assert!(read.is_err() || read.unwrap() != stored, "cut at {cut}");
        }
        for bit in 0..bytes.len() * 8 {
            let mut changed = bytes.to_vec();
            *changed.get_mut(bit / 8).unwrap() ^= 1 << (bit % 8);
            let read = StoredResult::from_bytes(changed.into());
            assert!(read.is_err() || read.unwrap() != stored, "bit {bit}");
        }
    }
}
