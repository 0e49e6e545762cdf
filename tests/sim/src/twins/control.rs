//! The commands that gates may let pass, by an arithmetic of its own. It records grants and stops after each block of each history, and
//! the time at which each block was certified.
//!
//! Source: docs/conflict.md and docs/security.md. A command passes a gate only if a certified state of the last second allows it: the
//! signer holds the service by that grant, and the robot is not stopped. After a signed stop that the gate was notified of, nothing
//! passes until a certified block has its verdict.

use crate::clock::{MILLISECOND, SECOND};
use crate::invariant::{Check, Violation};
use ledger::transaction::Transaction;
use ledger::{CallRef, Outcome};
use ledger_base::hash::Hash;
use ledger_storage::result::{Event, TransactionResult};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// For how long an answer of the voters counts, microseconds.
pub(super) const STALE_AFTER: u64 = SECOND;
/// Events of one moment have an order.
const SLACK: u64 = MILLISECOND;

/// The holder of each service with the epoch of the grant, and the robots that are stopped.
#[derive(Clone, Debug, Default)]
pub(super) struct Rights {
    holders: BTreeMap<String, (String, u64)>,
    stopped: BTreeSet<String>,
}

impl Rights {
    /// The epoch by which this person holds the service.
    pub(super) fn epoch(&self, service: &str, person: &str) -> Option<u64> {
        self.holders.get(service).filter(|(holder, _)| holder == person).map(|(_, epoch)| *epoch)
    }

    fn allow(&self, service: &str, person: &str, epoch: u64) -> bool {
        let is_stopped = service.split('/').next().is_some_and(|robot| self.stopped.contains(robot));
        !is_stopped && self.epoch(service, person) == Some(epoch)
    }
}

/// A block of some history, with what its transactions did.
pub(super) struct Block {
    pub(super) outcome: Outcome,
    /// Afterwards, and where a gate asks in it.
    pub(super) rights: Rights,
    asked: Vec<Rights>,
    stops: Vec<Hash>,
}

/// See the module.
#[derive(Default)]
pub(super) struct Control {
    /// Every block that a node has executed, by its hash.
    blocks: BTreeMap<Hash, Arc<Block>>,
    /// The blocks in which a transaction was executed.
    executed: BTreeMap<Hash, BTreeSet<Hash>>,
    /// The certified blocks by height, and since when each is certified.
    certified: BTreeMap<u64, (Hash, u64)>,
    /// The blocks that a certified one follows, and itself.
    settled: BTreeSet<Hash>,
    /// The stops that have a certified verdict.
    verdicts: BTreeSet<Hash>,
    /// Newest certified block time.
    time: u64,
    /// The stops that each bridge was notified of.
    notified: BTreeMap<usize, BTreeSet<CallRef>>,
}

#[derive(Deserialize)]
struct Granted {
    holder: String,
    epoch: u64,
}

impl Control {
    /// A node has executed a block.
    pub(super) fn executed(&mut self, outcome: &Outcome) {
        if self.blocks.contains_key(&outcome.hash) {
            return;
        }
        let mut rights =
            self.blocks.get(&outcome.header.previous).map(|before| before.rights.clone()).unwrap_or_default();
        let (mut asked, mut stops) = (Vec::new(), Vec::new());
        let mut events = outcome.events.iter().peekable();
        for (index, (bytes, id)) in outcome.transactions.iter().zip(&outcome.ids).enumerate() {
            while let Some(emitted) = events.next_if(|emitted| emitted.index.is_none_or(|at| at as usize <= index)) {
                apply(&mut rights, &emitted.event);
            }
            self.executed.entry(*id).or_default().insert(outcome.hash);
            match Transaction::decode(bytes.clone()).map(|transaction| transaction.body().function.clone()) {
                Ok(function) if function == "declare" => asked.push(rights.clone()),
                Ok(function) if function == "stop" => stops.push(*id),
                _ => {}
            }
        }
        events.for_each(|emitted| apply(&mut rights, &emitted.event));
        self.blocks.insert(outcome.hash, Arc::new(Block { outcome: outcome.clone(), rights, asked, stops }));
    }

    /// The block of a hash.
    pub(super) fn block(&self, hash: &Hash) -> Option<Arc<Block>> {
        self.blocks.get(hash).cloned()
    }

    /// The blocks in which a transaction was executed.
    pub(super) fn blocks_of(&self, id: &Hash) -> Vec<Arc<Block>> {
        let hashes = self.executed.get(id).into_iter().flatten();
        hashes.filter_map(|hash| self.block(hash)).collect()
    }

    /// A node has made a certificate of a block.
    pub(super) fn certified(&mut self, height: u64, hash: Hash, now: u64) {
        self.certified.entry(height).or_insert((hash, now));
        let mut next = Some(hash);
        while let Some(block) = next.filter(|hash| self.settled.insert(*hash)).and_then(|hash| self.blocks.get(&hash)) {
            self.verdicts.extend(block.stops.iter().copied());
            self.time = self.time.max(block.outcome.header.time);
            next = Some(block.outcome.header.previous);
        }
    }

    /// A bridge is notified of a stop that is not ordered yet.
    pub(super) fn notified(&mut self, bridge: usize, stop: CallRef) {
        self.notified.entry(bridge).or_default().insert(stop);
    }

    /// A bridge starts again, and has forgotten the stops that it was notified of.
    pub(super) fn forgets(&mut self, bridge: usize) {
        self.notified.remove(&bridge);
    }

    /// A gate lets a command pass.
    ///
    /// # Errors
    /// No certified state of the last second allows it, or a stop has no verdict yet.
    pub(super) fn passes(&mut self, bridge: usize, service: &str, (person, epoch): (&str, u64), now: u64) -> Check {
        let (time, verdicts) = (self.time, &self.verdicts);
        if let Some(notified) = self.notified.get_mut(&bridge) {
            notified.retain(|stop| stop.not_after >= time && !verdicts.contains(&stop.id));
            if let Some(stop) = notified.first() {
                let what = format!("bridge {bridge} lets {person} pass, and the stop {stop} has no verdict");
                return Err(Violation::new("a gate that was notified of a stop waits for its verdict", what));
            }
        }
        self.moves(bridge, service, (person, epoch), now)
    }

    /// The robot moves by a command that has passed.
    ///
    /// # Errors
    /// No certified state of the last second allows it.
    pub(super) fn moves(&self, bridge: usize, service: &str, (person, epoch): (&str, u64), now: u64) -> Check {
        let mut until = u64::MAX;
        for (hash, since) in self.certified.values().rev() {
            if until.saturating_add(STALE_AFTER + SLACK) < now {
                break;
            }
            let block = self.blocks.get(hash);
            let mut states = block.into_iter().flat_map(|block| block.asked.iter().chain([&block.rights]));
            if states.any(|rights| rights.allow(service, person, epoch)) {
                return Ok(());
            }
            until = until.min(*since);
        }
        let what = format!("bridge {bridge}: {person} moves {service} by epoch {epoch} at {now}");
        Err(Violation::new("no gate passes what no certified state of the last second allows", what))
    }
}

fn apply(rights: &mut Rights, event: &Event) {
    match &*event.name {
        "stopped" => drop(rights.stopped.insert(event.subject.clone())),
        "resumed" => drop(rights.stopped.remove(&event.subject)),
        "granted" | "released" if event.chaincode == "abac" => {
            let Granted { holder, epoch } = serde_json::from_slice(&event.payload).unwrap();
            if event.name == "granted" {
                rights.holders.insert(event.subject.clone(), (holder, epoch));
            } else if rights.epoch(&event.subject, &holder) == Some(epoch) {
                rights.holders.remove(&event.subject);
            }
        }
        _ => {}
    }
}

/// The result of a transaction in a block, and its place.
pub(super) fn result_of<'a>(block: &'a Block, id: &Hash) -> Option<(u32, &'a TransactionResult)> {
    let index = block.outcome.ids.iter().position(|other| other == id)?;
    Some((index as u32, block.outcome.results.get(index)?))
}
