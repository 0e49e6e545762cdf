//! Committed blocks are executed, observed and answered: the execute thread of a node.

use super::{Block, Timer, World};
use crate::invariant::{Check, Executed};
use crate::node::Answer;
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger::{Ledger, Outcome};
use ledger_hash::Hash;
use ledger_raft::Input;
use ledger_storage::entry::Entry;

impl World {
    /// Executes everything that is committed at a node.
    pub(super) fn execute(&mut self, id: u64) -> Check {
        let Some(mut running) = self.nodes.get_mut(&id).and_then(|node| node.up.take()) else { return Ok(()) };
        running.executing = false;
        let entries = std::mem::take(&mut running.committed);
        let check = entries.iter().try_for_each(|entry| self.executed(id, &running.ledger, entry));
        if let Some(node) = self.nodes.get_mut(&id) {
            node.up = Some(running);
        }
        check?;
        for entry in &entries {
            self.tell(id, entry.index)?;
        }
        self.catch_up(id)?;
        match entries.back() {
            Some(last) => {
                let at = self.nodes.get(&id).map_or(0, |node| node.clock.now(self.now));
                self.input(id, Input::Applied { height: last.index, at })
            }
            None => Ok(()),
        }
    }

    /// Checks what a node has executed, and keeps it if no other node was as far.
    pub(super) fn observe(&mut self, id: u64, ledger: &Ledger, entry: &Entry, outcome: Outcome) -> Check {
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
                self.invariants.state_agreement.same(id, &block.outcome, &outcome)?;
            }
        }
        self.invariants.executed(&Executed { node: id, outcome: &outcome, transactions: &transactions }, first)?;
        if first {
            for result in &outcome.results {
                *self.coverage.verdicts.entry(result.code()).or_default() += 1;
            }
            self.coverage.blocks += 1;
            self.members.push(ledger.members().unwrap_or_default());
            self.blocks.push(Block { entry: entry.clone(), outcome });
        }
        Ok(())
    }

    /// Answers who waits for a transaction of this block.
    fn tell(&mut self, id: u64, height: u64) -> Check {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let Some(block) = self.blocks.get(height as usize - 1) else { return Ok(()) };
        let mut answers = Vec::new();
        for ((index, transaction), result) in (0u32..).zip(&block.outcome.ids).zip(&block.outcome.results) {
            let Some(waiting) = running.waiters.remove(transaction) else { continue };
            // Only a verdict that took the id is the transaction's own (`src/waiters.rs`).
            let known = match result.not_after {
                None => running.ledger.transaction(transaction).ok().flatten(),
                Some(_) => None,
            };
            let (height, index, code, response) = match known {
                Some(record) => (record.height, record.index, record.result.code(), record.result.response),
                None => (height, index, result.code(), result.response.clone()),
            };
            let answer = Answer::Verdict { height, index, code, response };
            answers
                .extend(waiting.waiters.into_iter().map(|waiter| (*transaction, waiter.reply, height, answer.clone())));
        }
        for (transaction, reply, height, answer) in answers {
            self.acknowledge(id, &transaction, height)?;
            self.reply(id, reply, answer);
        }
        Ok(())
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

    /// Schedules the execution of what was committed.
    pub(super) fn committed(&mut self, id: u64, entries: Vec<Entry>) -> Check {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let term = running.engine.as_ref().map_or(u64::MAX, |engine| engine.status().role.term);
        for entry in &entries {
            self.invariants.committed.committed(id, entry)?;
            self.invariants.leader_completeness.committed(entry.index, entry.term, term);
        }
        running.committed.extend(entries);
        if !std::mem::replace(&mut running.executing, true) {
            let delay = 20 + self.random.nodes.below(if self.chaos { 2_000 } else { 200 });
            self.schedule_timer(id, delay, Timer::Execute);
        }
        Ok(())
    }

    /// Everything that a node holds of the world state.
    pub(crate) fn contents(&self, id: u64) -> Vec<(Bytes, Bytes)> {
        let state = self.nodes.get(&id).and_then(|node| node.up.as_ref()).map(|running| &running.state);
        state.map(|state| state.world(None, usize::MAX).unwrap()).unwrap_or_default()
    }
}
