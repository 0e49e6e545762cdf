//! Committed blocks are executed, observed and answered: the execute thread of a node.

use super::{Block, World};
use crate::coverage::Fault;
use crate::invariant::{Check, Executed};
use crate::people::organisation_of;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger::{Ledger, Outcome, msp};
use ledger_base::hash::Hash;
use ledger_raft::{Desired, Input};
use ledger_replica::Executor;
use ledger_replica::witness::seen;
use ledger_storage::entry::Entry;
use std::sync::Arc;

impl World {
    /// The execute thread executes everything it was given.
    pub(super) fn execute(&mut self, id: u64) -> Check {
        let Some(running) = self.running(id) else { return Ok(()) };
        running.executing = false;
        let entries: Vec<Entry> = running.given.iter().cloned().collect();
        self.execute_all(id, &entries)?;
        let at = self.clocks(id).clock;
        let Some(running) = self.running(id) else { return Ok(()) };
        running.given.clear();
        match entries.last() {
            Some(last) => self.input(id, Input::Applied { height: last.index, at }),
            None => Ok(()),
        }
    }

    /// Executes blocks, on whichever thread.
    pub(super) fn execute_all(&mut self, id: u64, entries: &[Entry]) -> Check {
        let Some(executor) = self.running(id).map(|running| Arc::clone(&running.executor)) else { return Ok(()) };
        for entry in entries {
            self.execute_one(id, &executor, entry)?;
        }
        executor.look_at_deadline();
        self.catch_up(id)
    }

    /// Executes a block, and tells everybody whom it concerns.
    pub(super) fn execute_one(&mut self, id: u64, executor: &Executor, entry: &Entry) -> Check {
        self.executed(id, executor, entry)?;
        self.tell(id)?;
        self.reads(id, |reads, now, out| reads.executed(now, entry.index, out))
    }

    /// A node takes note of what it has executed.
    fn take_note(&mut self, id: u64, outcome: &Outcome) {
        let me = format!("{}/node{id}", organisation_of(id, self.plan.organisations));
        let Some(running) = self.running(id) else { return };
        let (attestations, ordinary) = seen(outcome);
        attestations.iter().filter(|seen| seen.by == me).for_each(|own| running.said.note(&own.attest));
        if ordinary {
            running.ordinary = outcome.header.height;
        }
        let governed = outcome.events.iter().any(|emitted| emitted.event.chaincode == msp::NAME);
        if governed {
            running.wanted = Desired::read(&**running.ledger.state()).unwrap();
            running.wants_others = true;
        }
    }

    /// Checks what a node has executed, and keeps it if no other node was as far.
    pub(super) fn observe(&mut self, id: u64, ledger: &Ledger, entry: &Entry, outcome: &Outcome) -> Check {
        let (now, height) = (self.now, outcome.header.height);
        if let Some(node) = self.nodes.get_mut(&id) {
            node.clock.observe(now, outcome.header.time);
        }
        let first = height == self.blocks.len() as u64 + 1;
        let mut transactions = Vec::new();
        if first {
            transactions.extend(outcome.transactions.iter().map(|bytes| Transaction::decode(bytes.clone()).ok()));
            let codes: Vec<&str> = outcome.results.iter().map(|result| result.code().name()).collect();
            let (term, time, hash, digest) = (outcome.header.term, outcome.header.time, outcome.hash, outcome.digest);
            self.note(format_args!("n{id} block {height} term {term} time {time} {hash} digest {digest} {codes:?}"));
        } else {
            self.note(format_args!("n{id} block {height}"));
            if let Some(block) = self.blocks.get(height as usize - 1) {
                self.invariants.state_agreement.same(id, &block.outcome, outcome)?;
            }
        }
        self.take_note(id, outcome);
        let number = self.nodes.get(&id).and_then(|node| node.rules.take(height));
        self.invariants.rules_by_height.executed(id, height, number)?;
        self.invariants.executed(&Executed { node: id, outcome, transactions: &transactions }, first)?;
        if first {
            self.invariants.gate.executed(&Executed { node: id, outcome, transactions: &transactions }, now);
            for result in &outcome.results {
                *self.coverage.verdicts.entry(result.code()).or_default() += 1;
            }
            self.coverage.follow(outcome);
            self.book.follow(&self.people, &transactions, outcome);
            self.coverage.blocks += 1;
            if self.invariants.rules_by_height.decided(outcome) {
                self.coverage.fault(Fault::Activation);
            }
            let members = ledger.members().unwrap_or_default();
            self.records = msp::nodes(&**ledger.state()).unwrap();
            self.keeps_time(outcome)?;
            let before = self.newest_members().clone();
            self.invariants.members.executed(&before, &members, &self.records)?;
            self.members.push(members);
            self.strict.push(msp::certificate_rule(&**ledger.state()).unwrap().strict_since.is_some());
            self.blocks.push(Block { entry: entry.clone(), outcome: outcome.clone() });
        }
        self.state(id, ledger, outcome)
    }

    /// Looks at block time, before the block changes members.
    fn keeps_time(&mut self, outcome: &Outcome) -> Check {
        let (now, block) = (self.now, (outcome.header.height, outcome.header.time));
        let newest = self.members.last();
        let before = self.members.iter().rev().find(|set| Some(*set) != newest);
        let sets: Vec<_> = before.into_iter().chain(newest).flat_map(|set| [&set.voters, &set.outgoing]).collect();
        let latest = |voter| self.nodes.get(&voter).map_or(0, |node| node.clock.latest(now));
        self.invariants.keeps_time.executed(now, block, &sets, latest)
    }

    /// A client is about to hear that its transaction is in this block.
    pub(super) fn acknowledge(&mut self, id: u64, transaction: &Hash, height: u64) -> Check {
        let term = self.blocks.get(height as usize - 1).map_or(0, |block| block.outcome.header.term);
        self.note(format_args!("n{id} answers {transaction} with block {height}"));
        // A change of members takes effect when it is executed, so the blocks that were on their way behind it are
        // still decided by the set before; any since may have decided, too. (There is never more than one such change.)
        let (before, since) = self.members.split_at(height as usize);
        let last = before.iter().rev().find(|set| Some(*set) != since.first());
        let sets: Vec<_> = since.iter().chain(last).collect();
        self.invariants.acknowledged.acknowledged(height, term, &sets)
    }

    /// Everything that a node holds of the world state.
    pub(crate) fn contents(&self, id: u64) -> Vec<(Bytes, Bytes)> {
        let state = self.nodes.get(&id).and_then(|node| node.up.as_ref()).map(|running| running.ledger.state());
        state.map(|state| state.world(None, usize::MAX).unwrap()).unwrap_or_default()
    }
}
