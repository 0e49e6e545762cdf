//! The history of each client, in real time: every verdict is that of the chain. A call that returned before another
//! began comes before it in the chain. Nobody reads backwards; a linearizable read sees everything that anybody was
//! told.

use crate::history::{Kind, Outcome, Verdict};
use crate::invariant::Violation;
use crate::world::World;
use ledger_base::hash::Hash;
use ledger_base::rejection::Code;
use std::collections::BTreeMap;

const NAME: &str = "clients see one history";

/// Place in the chain.
type Place = (u64, u32);

/// Checks every client's view; answers with how many facts were checked.
pub(super) fn check(world: &World) -> Result<u64, Violation> {
    let places = places(world);
    let mut checks = 0;
    for verdict in &world.history.verdicts {
        check_verdict(world, &places, verdict)?;
        checks += 1;
    }
    checks += never(world, &places)?;
    checks += in_real_time(world, &places)?;
    checks += monotonic(world)?;
    checks += remembered(world)?;
    Ok(checks)
}

/// Where every transaction got its verdict.
fn places(world: &World) -> BTreeMap<Hash, Place> {
    let mut places = BTreeMap::new();
    for block in &world.blocks {
        for ((index, id), result) in (0u32..).zip(&block.outcome.ids).zip(&block.outcome.results) {
            // A copy that somebody else forged has no verdict of the transaction's own.
            if result.not_after.is_some() {
                places.entry(*id).or_insert((block.outcome.header.height, index));
            }
        }
    }
    places
}

fn check_verdict(world: &World, places: &BTreeMap<Hash, Place>, verdict: &Verdict) -> Result<(), Violation> {
    let block = world.blocks.get(verdict.height as usize - 1);
    let found = block.and_then(|block| {
        let at = verdict.index as usize;
        Some((block.outcome.ids.get(at)?, block.outcome.results.get(at)?))
    });
    let same = found.is_some_and(|(id, result)| {
        *id == verdict.id && result.code() == verdict.code && result.response == verdict.response
    });
    let first = places.get(&verdict.id) == Some(&(verdict.height, verdict.index));
    if same && (first || !is_final(verdict.code)) {
        return Ok(());
    }
    let (id, code, height, index) = (verdict.id, verdict.code.name(), verdict.height, verdict.index);
    Err(Violation::new(
        NAME,
        format!("a client was told {code} for {id} at {height}/{index}, which is not in the chain"),
    ))
}

/// Does this verdict take the id of the transaction?
fn is_final(code: Code) -> bool {
    use Code::{Duplicate, Expired, NotAfterTooFar, Revoked, UnknownCreator};
    !matches!(code, Duplicate | Expired | NotAfterTooFar | Revoked | UnknownCreator)
}

/// Every member answers who asks again with the same verdict at the same place.
fn remembered(world: &World) -> Result<u64, Violation> {
    let members = world.newest_members();
    let mut checks = 0;
    for id in members.voters.iter().chain(&members.learners) {
        let Some(running) = world.nodes.get(id).and_then(|node| node.up.as_ref()) else { continue };
        // What a snapshot has left behind, or what was dropped, nobody asks about.
        let first = running.ledger.results().first();
        let kept = |verdict: &&Verdict| is_final(verdict.code) && verdict.height >= first;
        for verdict in world.history.verdicts.iter().filter(kept) {
            checks += 1;
            let record = running.ledger.transaction(&verdict.id);
            let same = record.as_ref().is_ok_and(|record| {
                record.as_ref().is_some_and(|record| {
                    (record.height, record.index) == (verdict.height, verdict.index)
                        && record.result.code() == verdict.code
                        && record.result.response == verdict.response
                })
            });
            if !same {
                let what = format!("node {id} remembers {record:?} of a transaction with verdict {verdict:?}");
                return Err(Violation::new(NAME, what));
            }
        }
    }
    Ok(checks)
}

/// A transaction that was refused for good never happens.
fn never(world: &World, places: &BTreeMap<Hash, Place>) -> Result<u64, Violation> {
    let mut checks = 0;
    for operation in &world.history.operations {
        if let (Kind::Submit { id, .. }, Outcome::Refused { never: true, code, .. }) =
            (&operation.kind, &operation.result)
        {
            checks += 1;
            if let Some((height, index)) = places.get(id) {
                let code = code.name();
                let what = format!("{id} was refused with {code}, and executed at {height}/{index}");
                return Err(Violation::new(NAME, what));
            }
        }
    }
    Ok(checks)
}

/// Real-time order. A request that nobody answered may have been executed or not; if it was, then after it was begun.
fn in_real_time(world: &World, places: &BTreeMap<Hash, Place>) -> Result<u64, Violation> {
    let operations = &world.history.operations;
    let mut returned: Vec<(u64, Place)> = operations
        .iter()
        .filter_map(|operation| match &operation.result {
            Outcome::Executed(verdict) => Some((operation.returned?, (verdict.height, verdict.index))),
            // A read that was answered at a height has seen all of that block.
            Outcome::Read { height, .. } if is_linearizable(&operation.kind) => {
                Some((operation.returned?, (*height, u32::MAX)))
            }
            _ => None,
        })
        .collect();
    returned.sort_unstable();
    let mut returned = returned.into_iter().peekable();
    let (mut newest, mut checks) = ((0, 0), 0);
    // Operations are in the order in which they were begun.
    for (number, operation) in operations.iter().enumerate() {
        while let Some((_, place)) = returned.next_if(|(at, _)| *at < operation.invoked) {
            newest = newest.max(place);
        }
        let (what, place) = match (&operation.kind, &operation.result) {
            (Kind::Submit { id, .. }, _) => match places.get(id) {
                Some(place) => ("was executed", *place),
                None => continue,
            },
            (Kind::Read { linearizable: true, .. }, Outcome::Read { height, .. }) => {
                // Seeing the whole block of the newest is enough.
                ("read", (*height, u32::MAX))
            }
            _ => continue,
        };
        checks += 1;
        let before = if what == "read" { place < newest } else { place <= newest };
        if before {
            let what =
                format!("operation {number} {what} at {place:?}, and {newest:?} had been answered before it began");
            return Err(Violation::new(NAME, what));
        }
    }
    Ok(checks)
}

fn is_linearizable(kind: &Kind) -> bool {
    matches!(kind, Kind::Read { linearizable: true, .. })
}

/// Nobody reads behind what they have seen.
fn monotonic(world: &World) -> Result<u64, Violation> {
    let mut checks = 0;
    for (number, operation) in world.history.operations.iter().enumerate() {
        if let (Kind::Read { min_height, .. }, Outcome::Read { height, .. }) = (&operation.kind, &operation.result) {
            checks += 1;
            if height < min_height {
                let client = operation.client;
                let what = format!("operation {number}: client {client} had seen {min_height} and read {height}");
                return Err(Violation::new(NAME, what));
            }
        }
    }
    Ok(checks)
}
