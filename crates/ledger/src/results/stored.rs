//! The result of a block as it is kept: without what the block beside it tells.

use crate::Hash;
use crate::block::Payload;
use crate::chaincode::{Event, Foretold, Registry};
use crate::code::Code;
use crate::entry::Entry;
use crate::rejection::Rejection;
use crate::result::{BlockResult, EmittedEvent, TransactionResult};
use crate::transaction::Transaction;
use bytes::Bytes;
use prost::Message;

/// Bytes of an id that are kept where the block has the rest: what [the window](super::Window) knows of it, so that a
/// node starts without reading its blocks.
const ID_BYTES: usize = 16;

/// A result that is kept whole, or short: beside its block.
///
/// Short, it has no term; ids are cut to [`ID_BYTES`]; `not_after` counts from the block's time; and a transaction that
/// came out as its call [foretells](crate::Chaincode::foretell) has neither response nor events.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StoredResult {
    result: BlockResult,
    /// Short: for each transaction 1 if it came out as foretold, else 0. Whole: empty.
    foretold: Bytes,
}

/// What a short result has more than a whole one. Stands behind the fields of [`BlockResult`] in the same message.
#[derive(Clone, PartialEq, Eq, prost::Message)]
struct Short {
    #[prost(bytes = "bytes", tag = "8")]
    foretold: Bytes,
}

impl StoredResult {
    /// All of it: for results that came without their blocks.
    pub(super) fn whole(result: BlockResult) -> Self {
        Self { result, foretold: Bytes::new() }
    }

    /// What its block does not tell. `foretold` says which transactions came out as their calls foretell.
    pub(super) fn short(result: &BlockResult, foretold: &[bool]) -> Self {
        let told = |index: Option<u32>| index.and_then(|index| foretold.get(index as usize)).is_some_and(|told| *told);
        let results = result.results.iter().zip(foretold).map(|(outcome, told)| TransactionResult {
            response: if *told { Bytes::new() } else { outcome.response.clone() },
            id: outcome.id.slice(..outcome.id.len().min(ID_BYTES)),
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
        };
        Self { result: short, foretold: foretold.iter().copied().map(u8::from).collect() }
    }

    pub(super) fn to_bytes(&self) -> Bytes {
        let mut bytes = self.result.encode_to_vec();
        bytes.extend(Short { foretold: self.foretold.clone() }.encode_to_vec());
        bytes.into()
    }

    pub(super) fn from_bytes(bytes: Bytes) -> Result<Self, Rejection> {
        let unreadable = |error: &dyn std::fmt::Display| {
            Rejection::new(Code::Corrupt, format!("a stored block result cannot be read: {error}"))
        };
        let Short { foretold } = Short::decode(bytes.clone()).map_err(|error| unreadable(&error))?;
        let result = BlockResult::decode(bytes).map_err(|error| unreadable(&error))?;
        if !foretold.is_empty() && foretold.len() != result.results.len() {
            return Err(unreadable(&format!("{} marks for {} results", foretold.len(), result.results.len())));
        }
        Ok(Self { result, foretold })
    }

    /// Block time, microseconds.
    pub(crate) fn time(&self) -> u64 {
        self.result.time
    }

    /// Hash of the block's header.
    pub(crate) fn hash(&self) -> Hash {
        self.result.hash()
    }

    /// State digest after the block.
    pub(crate) fn digest(&self) -> Hash {
        self.result.digest()
    }

    /// Does it take the block to read it?
    pub(super) fn is_short(&self) -> bool {
        !self.foretold.is_empty()
    }

    /// The transactions whose ids the block has taken: position, the first half of the id, until when it is remembered.
    pub(crate) fn taken(&self) -> impl Iterator<Item = (u32, Hash, u64)> + '_ {
        let since = if self.is_short() { self.result.time } else { 0 };
        (0u32..).zip(&self.result.results).filter_map(move |(position, result)| {
            Some((position, half(&result.id), result.not_after?.saturating_add(since)))
        })
    }

    /// The whole result, if no block is needed for that.
    pub(super) fn into_whole(self) -> Option<BlockResult> {
        (!self.is_short()).then_some(self.result)
    }

    /// Is the transaction at this position the one with this id? Compares what is kept of it.
    pub(super) fn has(&self, position: u32, id: &Hash) -> bool {
        let found = self.result.results.get(position as usize);
        found.is_some_and(|result| result.id.len() >= ID_BYTES && id.0.starts_with(&result.id))
    }

    /// The whole result; `entry` is its block.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if the two do not belong together.
    pub(crate) fn complete(self, entry: &Entry, registry: &Registry) -> Result<BlockResult, Rejection> {
        if !self.is_short() {
            return Ok(self.result);
        }
        let transactions = self.transactions(entry)?;
        let Self { mut result, foretold } = self;
        result.term = entry.term;
        let mut kept = std::mem::take(&mut result.events).into_iter().peekable();
        result.events.extend(std::iter::from_fn(|| kept.next_if(|emitted| emitted.index.is_none())));
        let outcomes = result.results.iter_mut().zip(foretold);
        for (position, (encoded, (outcome, told))) in (0u32..).zip(transactions.into_iter().zip(outcomes)) {
            let index = Some(position);
            let events = complete(outcome, told, encoded, result.time, registry).ok_or_else(|| apart(entry))?;
            result.events.extend(events.into_iter().map(|event| EmittedEvent { index, event }));
            result.events.extend(std::iter::from_fn(|| kept.next_if(|emitted| emitted.index == index)));
        }
        if kept.next().is_some() { Err(apart(entry)) } else { Ok(result) }
    }

    /// What became of one transaction; `entry` is its block. None if it has no such transaction.
    ///
    /// # Errors
    /// As [`StoredResult::complete`].
    pub(super) fn transaction(
        mut self,
        position: u32,
        entry: &Entry,
        registry: &Registry,
    ) -> Result<Option<TransactionResult>, Rejection> {
        let (time, place) = (self.result.time, position as usize);
        let transactions = if self.is_short() { self.transactions(entry)? } else { Vec::new() };
        let Some(outcome) = self.result.results.get_mut(place) else { return Ok(None) };
        let mut outcome = std::mem::take(outcome);
        if let (Some(encoded), Some(told)) = (transactions.into_iter().nth(place), self.foretold.get(place)) {
            complete(&mut outcome, *told, encoded, time, registry).ok_or_else(|| apart(entry))?;
        }
        Ok(Some(outcome))
    }

    /// The transactions of its block.
    fn transactions(&self, entry: &Entry) -> Result<Vec<Bytes>, Rejection> {
        let payload = Payload::from_bytes(entry.data.clone()).ok();
        let transactions = payload.map(|payload| payload.transactions);
        transactions.filter(|found| found.len() == self.foretold.len()).ok_or_else(|| apart(entry))
    }
}

/// Puts back what is not kept of a transaction's result; answers with the events that are not kept. None if this is the
/// result of another transaction.
fn complete(
    outcome: &mut TransactionResult,
    told: u8,
    encoded: Bytes,
    time: u64,
    registry: &Registry,
) -> Option<Vec<Event>> {
    let transaction = Transaction::decode(encoded).ok();
    let id = transaction.as_ref().map_or(Bytes::new(), |found| Bytes::copy_from_slice(&found.id().0));
    if outcome.id != id.slice(..id.len().min(ID_BYTES)) {
        return None;
    }
    outcome.id = id;
    outcome.not_after = outcome.not_after.map(|left| left.saturating_add(time));
    if told == 0 {
        return Some(Vec::new());
    }
    let call = transaction.as_ref()?.body();
    let Foretold { response, events } = registry.foretell(&call.chaincode, &call.function, &call.args)?;
    outcome.response = response;
    Some(events)
}

fn apart(entry: &Entry) -> Rejection {
    Rejection::new(Code::Corrupt, format!("block {} and its result do not belong together", entry.index))
        .next("stop the node and delete its directories state/ and results/; it makes them again from the blocks")
}

/// The first half of an id, then zeros.
fn half(id: &[u8]) -> Hash {
    let mut half = Hash::ZERO;
    half.0.iter_mut().zip(id.iter().take(ID_BYTES)).for_each(|(to, from)| *to = *from);
    half
}
