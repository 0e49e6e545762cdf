//! Results as a node keeps them, made whole: what the block tells and what its calls
//! [foretell](crate::Chaincode::foretell) is put back.

use crate::block::Payload;
use crate::chaincode::{Foretold, Registry};
use crate::transaction::Transaction;
use bytes::Bytes;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::entry::Entry;
use ledger_storage::result::{BlockResult, EmittedEvent, Event, TransactionResult};
use ledger_storage::results::{Blocks, Place, ResultStore, SHORT_ID_BYTES, StoredResult};
use std::collections::VecDeque;

/// Bytes of blocks that are read at once while many results are completed.
const AHEAD_BYTES: usize = 256 * 1024;

/// The whole result of the block at a height; none if there is none or it was dropped.
///
/// # Errors
/// As [`ResultStore::get`].
pub(crate) fn whole(results: &ResultStore, height: u64, registry: &Registry) -> Result<Option<BlockResult>, Rejection> {
    match results.get(height)? {
        Some(stored) => Completing::new(results, registry, height).complete(height, stored),
        None => Ok(None),
    }
}

/// The outcome of a transaction, and the time of its block; none if that was dropped.
///
/// # Errors
/// As [`ResultStore::get`].
pub(crate) fn transaction(
    results: &ResultStore,
    place: Place,
    registry: &Registry,
) -> Result<Option<(u64, TransactionResult)>, Rejection> {
    let Some(stored) = results.get(place.height)? else { return Ok(None) };
    let time = stored.time();
    let result = Completing::new(results, registry, place.height).transaction(place, stored)?;
    Ok(result.map(|result| (time, result)))
}

/// Completes results with their blocks, which it reads many at once.
pub(crate) struct Completing<'a> {
    blocks: Option<&'a dyn Blocks>,
    registry: &'a Registry,
    /// No result above this height will be asked for.
    last: u64,
    read: VecDeque<Entry>,
}

impl<'a> Completing<'a> {
    /// For results up to a height.
    pub(crate) fn new(results: &'a ResultStore, registry: &'a Registry, last: u64) -> Self {
        Self { blocks: results.blocks(), registry, last, read: VecDeque::new() }
    }

    /// The whole result of a height; none if its block was dropped. Heights grow from call to call.
    ///
    /// # Errors
    /// [`Code::Corrupt`] if the two do not belong together; a fault of the disk.
    pub(crate) fn complete(&mut self, height: u64, stored: StoredResult) -> Result<Option<BlockResult>, Rejection> {
        if !stored.is_short() {
            return Ok(Some(stored.into_parts().0));
        }
        let block = self.block(height)?;
        block.map(|block| complete(stored, &block, self.registry)).transpose()
    }

    /// The outcome of one transaction; none if its block was dropped, or has no such transaction.
    ///
    /// # Errors
    /// As [`Completing::complete`].
    fn transaction(&mut self, place: Place, stored: StoredResult) -> Result<Option<TransactionResult>, Rejection> {
        let position = place.position as usize;
        if !stored.is_short() {
            return Ok(stored.into_parts().0.results.into_iter().nth(position));
        }
        let Some(block) = self.block(place.height)? else { return Ok(None) };
        let (result, foretold) = stored.into_parts();
        let (encoded, time) = (transactions(&block, foretold.len())?.into_iter().nth(position), result.time);
        let Some(mut outcome) = result.results.into_iter().nth(position) else { return Ok(None) };
        if let (Some(encoded), Some(foretold)) = (encoded, foretold.get(position)) {
            put_back(&mut outcome, *foretold, encoded, time, self.registry).ok_or_else(|| apart(&block))?;
        }
        Ok(Some(outcome))
    }

    fn block(&mut self, height: u64) -> Result<Option<Entry>, Rejection> {
        let Some(blocks) = self.blocks else { return Ok(None) };
        while self.read.pop_front_if(|entry| entry.index < height).is_some() {}
        if self.read.is_empty() {
            self.read = blocks.blocks(height..self.last.max(height) + 1, AHEAD_BYTES)?.into();
        }
        Ok(self.read.pop_front_if(|entry| entry.index == height))
    }
}

/// The whole result; `entry` is its block.
///
/// # Errors
/// [`Code::Corrupt`] if the two do not belong together.
pub(crate) fn complete(stored: StoredResult, entry: &Entry, registry: &Registry) -> Result<BlockResult, Rejection> {
    if !stored.is_short() {
        return Ok(stored.into_parts().0);
    }
    let (mut result, foretold) = stored.into_parts();
    let transactions = transactions(entry, foretold.len())?;
    result.term = entry.term;
    let mut kept = std::mem::take(&mut result.events).into_iter().peekable();
    result.events.extend(std::iter::from_fn(|| kept.next_if(|emitted| emitted.index.is_none())));
    let outcomes = result.results.iter_mut().zip(foretold);
    for (position, (encoded, (outcome, foretold))) in (0u32..).zip(transactions.into_iter().zip(outcomes)) {
        let index = Some(position);
        let events = put_back(outcome, foretold, encoded, result.time, registry).ok_or_else(|| apart(entry))?;
        result.events.extend(events.into_iter().map(|event| EmittedEvent { index, event }));
        result.events.extend(std::iter::from_fn(|| kept.next_if(|emitted| emitted.index == index)));
    }
    if kept.next().is_some() { Err(apart(entry)) } else { Ok(result) }
}

/// The transactions of a block, as many as are wanted.
fn transactions(entry: &Entry, wanted: usize) -> Result<Vec<Bytes>, Rejection> {
    let payload = Payload::from_bytes(entry.data.clone()).ok();
    let transactions = payload.map(|payload| payload.transactions);
    transactions.filter(|found| found.len() == wanted).ok_or_else(|| apart(entry))
}

/// Puts back what is not kept of a transaction's result; answers with the events that are not kept. None if this is the
/// result of another transaction.
fn put_back(
    outcome: &mut TransactionResult,
    foretold: bool,
    encoded: Bytes,
    time: u64,
    registry: &Registry,
) -> Option<Vec<Event>> {
    let transaction = Transaction::decode(encoded).ok();
    let id = transaction.as_ref().map_or(Bytes::new(), |found| Bytes::copy_from_slice(&found.id().0));
    if outcome.id != id.slice(..id.len().min(SHORT_ID_BYTES)) {
        return None;
    }
    outcome.id = id;
    outcome.not_after = outcome.not_after.map(|left| left.saturating_add(time));
    if !foretold {
        return Some(Vec::new());
    }
    let call = transaction.as_ref()?.body();
    let Foretold { response, events } = registry.foretell(&call.chaincode, &call.function, &call.args)?;
    outcome.response = response;
    Some(events)
}

fn apart(entry: &Entry) -> Rejection {
    Rejection::new(Code::Corrupt, format!("block {} and its result do not match", entry.index))
        .next("stop the node and delete its directories state/ and results/; both are rebuilt from the blocks")
}
