//! The order thread of a node: inputs into the engine, its outputs carried out.

use super::{Event, Timer, World};
use crate::clock::MILLISECOND;
use crate::coverage::Fault;
use crate::invariant::Check;
use crate::node::{Answer, Refused, WAIT_MAX};
use bytes::Bytes;
use ledger::transaction::Transaction;
use ledger_raft::{Input, Output, PeerMessage, RaftKind, Role, RoleChange, next_step, successor};
use ledger_rejection::Code;
use ledger_storage::block_store::StoreError;

/// Pause before a write is tried again that found no space (`src/orderer.rs`).
const FULL_DISK_PAUSE: u64 = 100 * MILLISECOND;

impl World {
    /// Hands an input to a node's engine; while its thread is busy with the disk, it waits in the inbox.
    pub(super) fn input(&mut self, id: u64, input: Input) -> Check {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        if running.flushing && running.waits_for_disk {
            running.inbox.push_back(input);
            return Ok(());
        }
        self.step(id, input)
    }

    fn step(&mut self, id: u64, input: Input) -> Check {
        let now = self.now;
        let Some(node) = self.nodes.get_mut(&id) else { return Ok(()) };
        let clock = node.clock.now(now);
        let Some(running) = node.up.as_mut() else { return Ok(()) };
        let mut outputs = Vec::new();
        let Some(engine) = running.engine.as_mut() else { return Ok(()) };
        engine.step(clock, input, &mut outputs);
        if outputs.iter().any(|output| matches!(output, Output::Flush { .. } | Output::Role(_))) {
            self.invariants.log_matching.look(id, &running.store)?;
        }
        // Nothing that comes after the end of an engine is carried out.
        outputs.into_iter().try_for_each(|output| match self.has_engine(id) {
            true => self.carry_out(id, output),
            false => Ok(()),
        })
    }

    fn carry_out(&mut self, id: u64, output: Output) -> Check {
        match output {
            Output::Send { to, message } => return self.send(id, to, &message),
            Output::Flush { ready } => self.flush(id, ready),
            Output::Commit(entries) => return self.committed(id, entries),
            Output::Role(change) => return self.role(id, change),
            Output::Membership { height, membership } => {
                self.note(format_args!("n{id} members at {height}: {membership:?}"));
            }
            Output::Dropped { transaction, reason } => self.dropped(id, transaction, reason.code),
            Output::ReadReady { context, index } => {
                let running = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut());
                if let Some(read) = running.and_then(|running| running.reads.get_mut(&context)) {
                    read.index = Some(index);
                }
                return self.catch_up(id);
            }
            Output::Refused { input, reason } => match *input {
                Input::ReadIndex { context } => self.read_refused(id, context, reason),
                input => self.note(format_args!("n{id} refuses {input:?}: {}", reason.code)),
            },
            Output::Behind { first_index, .. } => return self.behind(id, first_index),
            Output::Failed(reason) => return self.failed(id, &reason.to_string()),
        }
        Ok(())
    }

    fn has_engine(&self, id: u64) -> bool {
        self.nodes.get(&id).and_then(|node| node.up.as_ref()).is_some_and(|running| running.engine.is_some())
    }

    fn role(&mut self, id: u64, change: RoleChange) -> Check {
        self.note(format_args!("n{id} {:?} of term {}, leader {:?}", change.role, change.term, change.leader));
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let elected = change.role == Role::Leader && !running.leading;
        running.leading = change.role == Role::Leader;
        running.asked_for = (0, 0);
        running.submit_again = change.leader.is_some();
        if running.leading {
            self.invariants.election_safety.leads(id, change.term)?;
        }
        if elected {
            self.invariants.leader_completeness.elected(id, change.term, &running.store)?;
        }
        Ok(())
    }

    fn send(&mut self, id: u64, to: u64, message: &PeerMessage) -> Check {
        if let PeerMessage::Raft(raft) = message {
            let (kind, term, index, entries) = (raft.kind(), raft.term, raft.index, raft.entries.len());
            let (commit, reject) = (raft.commit, if raft.reject { " refused" } else { "" });
            match kind {
                RaftKind::VoteResponse if !raft.reject => {
                    self.invariants.election_safety.votes(id, term, to)?;
                    self.forgets(id);
                }
                RaftKind::Vote => self.invariants.election_safety.votes(id, term, id)?,
                _ => {}
            }
            let what =
                format_args!("n{id} > n{to} {kind:?} term {term} index {index} +{entries} commit {commit}{reject}");
            self.trace.note(self.now, what);
        } else {
            self.note(format_args!("n{id} > n{to} transactions"));
        }
        let bytes = message.to_bytes();
        for at in self.links.send(self.now, (id, to), &mut self.random.network, &mut self.coverage) {
            self.schedule_at(at, Event::Deliver { from: id, to, bytes: bytes.clone() });
        }
        Ok(())
    }

    /// Who has just voted is made to forget it, if it can: power fails now and then at this moment.
    fn forgets(&mut self, id: u64) {
        let fault = Fault::Crash;
        if self.chaos && self.plan.faults.contains(&fault) && self.random.faults.percent(10) {
            self.fell(fault, id, true);
        }
    }

    /// A message arrives.
    pub(super) fn deliver(&mut self, from: u64, to: u64, bytes: Bytes) -> Check {
        // A node whose disk is gone has no key with which to speak any more.
        if self.nodes.get(&from).is_none_or(|node| node.lost) {
            return Ok(());
        }
        let message = PeerMessage::decode(bytes).unwrap();
        self.input(to, Input::Message { from, message })
    }

    /// What a process does at its own time.
    pub(super) fn timer(&mut self, id: u64, timer: Timer) -> Check {
        match timer {
            Timer::Tick => {
                self.schedule_timer(id, self.plan.tick, Timer::Tick);
                self.input(id, Input::Tick)?;
                self.reconcile(id)?;
                self.leave_full_disk(id)?;
                self.submit_again(id)?;
                self.meet_deadline(id)
            }
            Timer::Flushed => self.flushed(id),
            Timer::Execute => self.execute(id),
            Timer::CatchUp => self.fetch(id),
            Timer::Housekeeping => self.keep_house(id),
        }
    }

    /// What was given to a leader that is gone may be lost with it: everything that still waits goes to the next one.
    fn submit_again(&mut self, id: u64) -> Check {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        if !std::mem::take(&mut running.submit_again) {
            return Ok(());
        }
        let mut all: Vec<_> =
            running.waiters.values().map(|waiting| (waiting.number, waiting.lane, waiting.encoded.clone())).collect();
        all.sort_unstable_by_key(|(number, ..)| *number);
        all.into_iter().try_for_each(|(_, lane, transaction)| self.input(id, Input::Submit { lane, transaction }))
    }

    /// A leader without space answers nobody: another voter shall lead.
    fn leave_full_disk(&mut self, id: u64) -> Check {
        let running = self.nodes.get(&id).and_then(|node| node.up.as_ref());
        let full = running.filter(|running| running.leading && running.disk_full);
        match full.and_then(|running| successor(&running.engine.as_ref()?.status())) {
            Some(to) => self.step(id, Input::TransferLeadership { to }),
            None => Ok(()),
        }
    }

    /// A leader brings the members to what the operator wants.
    fn reconcile(&mut self, id: u64) -> Check {
        let Some(running) = self.nodes.get(&id).and_then(|node| node.up.as_ref()) else { return Ok(()) };
        let Some(engine) = running.engine.as_ref().filter(|_| running.leading) else { return Ok(()) };
        match next_step(&self.desired, &engine.status()) {
            Some(step) => self.input(id, step),
            None => Ok(()),
        }
    }

    /// Orders an empty block when something is due and no traffic moved block time past it.
    fn meet_deadline(&mut self, id: u64) -> Check {
        let now = self.now;
        let Some(node) = self.nodes.get_mut(&id) else { return Ok(()) };
        let clock = node.clock.now(now);
        let Some(running) = node.up.as_mut().filter(|running| running.leading) else { return Ok(()) };
        let deadline = running.ledger.next_deadline().unwrap_or(u64::MAX);
        let asking_for = (deadline, running.ledger.tip().height);
        if clock < deadline || running.asked_for == asking_for {
            return Ok(());
        }
        running.asked_for = asking_for;
        self.input(id, Input::ProposeEmpty)
    }

    /// The log is to be flushed: that takes time.
    fn flush(&mut self, id: u64, ready: u64) {
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return };
        running.flush = Some(ready);
        if std::mem::replace(&mut running.flushing, true) {
            return;
        }
        let mut time = 50 + self.random.disk.below(self.plan.disk_max);
        if self.chaos && self.plan.faults.contains(&Fault::SlowDisk) && self.random.disk.percent(2) {
            self.coverage.fault(Fault::SlowDisk);
            time += self.random.disk.below(50 * self.plan.disk_max);
        }
        self.schedule_timer(id, time, Timer::Flushed);
    }

    fn flushed(&mut self, id: u64) -> Check {
        if self.nodes.get(&id).is_some_and(|node| node.tear) {
            self.tear(id);
            return Ok(());
        }
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        let Some(ready) = running.flush.take() else { return Ok(()) };
        match running.store.flush() {
            Ok(durable) => {
                (running.flushing, running.disk_full) = (false, false);
                self.invariants.acknowledged.flushed(id, &running.store);
                let inbox = std::mem::take(&mut running.inbox);
                self.note(format_args!("n{id} flushed {ready}, durable up to {durable}"));
                self.step(id, Input::Persisted { ready })?;
                inbox.into_iter().try_for_each(|input| self.input(id, input))
            }
            Err(StoreError::DiskFull { .. }) => {
                let known = std::mem::replace(&mut running.disk_full, true);
                running.flush = Some(ready);
                // The thread looks at what came in between two attempts.
                let inbox = std::mem::take(&mut running.inbox);
                if !known {
                    self.coverage.fault(Fault::FullDisk);
                    self.note(format_args!("n{id} has no room"));
                }
                self.schedule_timer(id, FULL_DISK_PAUSE, Timer::Flushed);
                inbox.into_iter().try_for_each(|input| self.step(id, input))
            }
            Err(error) => {
                self.note(format_args!("n{id} cannot flush: {error}"));
                self.failed(id, &error.to_string())
            }
        }
    }

    fn keep_house(&mut self, id: u64) -> Check {
        let now = self.now;
        self.schedule_timer(id, self.plan.state_flush, Timer::Housekeeping);
        let Some(running) = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut()) else { return Ok(()) };
        // A full disk keeps it in memory; the blocks have it.
        let kept = running.ledger.flush_up_to(running.store.durable_index(), Some(&running.snapshots));
        let reached = running.state.stored().map_or(0, |tip| tip.height);
        if let Some(snapshot) = running.snapshots.newest() {
            let (height, content) = (snapshot.manifest().height, snapshot.content());
            self.invariants.state_agreement.snapshot(id, height, content)?;
        }
        let prepared = if self.plan.prepares { running.store.prepare() } else { Ok(false) };
        let mut late = Vec::new();
        running.waiters.retain(|_, waiting| {
            let expired = waiting.waiters.iter().any(|waiter| now > waiter.since + WAIT_MAX);
            if expired {
                late.append(&mut waiting.waiters);
            }
            !expired
        });
        for waiter in late {
            self.reply(id, waiter.reply, Answer::Refused(Refused::unordered(Code::Timeout)));
        }
        match prepared {
            Ok(_) | Err(StoreError::DiskFull { .. }) => {}
            Err(error) => return self.failed(id, &error.to_string()),
        }
        self.catch_up(id)?;
        if kept.is_ok()
            && let Some(node) = self.nodes.get_mut(&id)
        {
            node.saved = reached;
        }
        self.prune(id)
    }

    fn dropped(&mut self, id: u64, transaction: Bytes, code: Code) {
        let Ok(transaction) = Transaction::decode(transaction) else { return };
        self.note(format_args!("n{id} drops {}: {code}", transaction.id()));
        let running = self.nodes.get_mut(&id).and_then(|node| node.up.as_mut());
        let waiting = running.and_then(|running| running.waiters.remove(&transaction.id()));
        for waiter in waiting.map(|waiting| waiting.waiters).unwrap_or_default() {
            self.reply(id, waiter.reply, Answer::Refused(Refused::unordered(code)));
        }
    }
}
